"""The occupancy grid, its frontiers, and paths through it."""
