"""Mapping: SLAM, status, places and grid of one robot or several, in one frame or one frame after
the other.
"""
