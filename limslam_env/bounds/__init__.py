"""Bounds for comparison: exploration tours that are planned with the true map."""
