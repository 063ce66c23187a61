"""Two logs of one building, whose relative start is not known: they become one map, or stay
apart.
"""
