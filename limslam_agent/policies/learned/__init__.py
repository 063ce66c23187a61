"""A learned exploration policy that runs in numpy, with its weights."""
