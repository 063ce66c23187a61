"""The command line ``limslam``. What a user can correct is a ValueError of one line in every
function.
"""
