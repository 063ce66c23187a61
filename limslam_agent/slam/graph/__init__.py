"""A graph of local maps with loops, which smooths a recorded log after its end."""
