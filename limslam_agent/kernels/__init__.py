"""Compiled parts of a step of the agent: covariances of the filter, lines, grid, frontiers, paths,
and rays.

Loading numba takes long, so modules of other packages import these ones inside of the functions
that use them.
"""
