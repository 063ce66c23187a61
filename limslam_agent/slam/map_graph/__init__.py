"""The graph of local maps with loops, which smooths a recorded log after its end, and while it is
driven.
"""
