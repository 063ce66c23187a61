"""The graph of local maps while the robot drives: each pose uses only what was known at its
time.
"""
