"""SLAM with line landmarks: `LineSlam`, and below it the estimators."""
