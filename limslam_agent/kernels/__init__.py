"""Compiled parts of a step of the agent: grid, frontiers, paths, and beams beside walls.

Loading numba takes long, so modules of other packages import these ones inside of the functions that use them.
"""
