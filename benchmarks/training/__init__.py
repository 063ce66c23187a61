"""Training of the learned exploration policy, and its comparison with other policies."""
