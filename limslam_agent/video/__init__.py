"""Video of a run: the truth beside the belief, with captions that explain the method."""
