"""The environments for Gymnasium and PettingZoo, single and batched, and their wrappers."""
