"""Compiled inner loops: rays, readings, contact, random numbers, coverage, and the step of a
batch.
"""
