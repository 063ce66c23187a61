"""Training of the learned explorer, and its comparison with others."""
