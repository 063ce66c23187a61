"""Least squares: the sparse normal equations of a graph, their solution, and covariances of its
unknowns.
"""
