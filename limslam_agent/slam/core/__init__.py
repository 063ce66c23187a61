"""What the estimators share: motion, readings, the Hough transform, line fits, and the Kalman filter."""
