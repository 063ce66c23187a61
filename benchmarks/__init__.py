"""Benchmarks, run from a checkout as ``python -m benchmarks.NAME``; they are not installed."""
