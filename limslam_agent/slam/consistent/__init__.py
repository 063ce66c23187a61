"""The consistent estimator: cloned poses, one update for each reading, walls with known extents."""
