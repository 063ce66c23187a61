"""The environments for Gymnasium and PettingZoo, single ones and batches, and their wrappers."""
