"""The film of a run: the truth beside the belief."""
