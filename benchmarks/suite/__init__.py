"""Suites of runs: their jobs, the engines that execute them, and the storage of their results."""
