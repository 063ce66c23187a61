"""A graph of local maps with loops: smooths a recorded log after it has ended."""
