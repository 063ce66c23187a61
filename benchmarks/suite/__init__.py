"""Suites of runs: which jobs they are, how they are executed, and where their results are kept."""
