"""Datasets for offline reinforcement learning, in the format of Minari: drives of explorers on random plans."""
