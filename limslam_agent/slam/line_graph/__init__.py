"""Smoothing: all poses of a run solved for together, with associations that can be taken back."""
