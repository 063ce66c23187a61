"""What every series of runs needs: processes that do them, a folder that keeps them, and statistics
of them.
"""
