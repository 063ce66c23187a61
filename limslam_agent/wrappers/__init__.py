"""Environment wrappers whose observation is the belief of the SLAM."""
