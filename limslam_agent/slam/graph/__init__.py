"""The factor graph of both smoothers: nodes, factors, robust weights, solution and covariances."""
