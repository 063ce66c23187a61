"""The scoreboard: one command that says whether a change of the estimator is kept."""
