"""Policies: from the belief of a robot to the speeds of its wheels."""
