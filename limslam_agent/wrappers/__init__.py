"""Wrappers that give learning agents the belief of the SLAM as their observation."""
