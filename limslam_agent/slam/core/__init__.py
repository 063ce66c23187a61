"""What the estimators share: motion, readings, lines and their fits; and the Kalman filter of the
published method.
"""
