"""The inspector: one HTML file that plays a run step by step, and needs neither a server nor a
network.
"""
