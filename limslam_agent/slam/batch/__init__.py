"""The consistent estimator for many robots at once, compiled."""
