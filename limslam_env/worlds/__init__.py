"""Worlds: walls, obstacles, doors and starts; the files that describe them; and random floor
plans.
"""
