"""Finding a place again: a local map is matched with another map, and a match counts only if it is
unambiguous.
"""
