"""Settings: one module for each estimator, one for exploration, and the presets."""
