"""Bounds for comparison: the offline optimum of a log, and exploration tours planned with the true map."""
