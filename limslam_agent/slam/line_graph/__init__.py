"""Smoothing of a finished run: all poses are solved for together, and wrong associations can be
corrected.
"""
