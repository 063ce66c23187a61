"""The simulation of many environments at once, on arrays."""
