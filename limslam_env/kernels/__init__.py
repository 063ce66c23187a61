"""Compiled inner loops: rays and readings, contact, random numbers, coverage, and the step of a batch."""
