"""``python -m limslam_env`` says what the package is and how to use it."""

import sys

from limslam_env import __version__

TEXT = f"""\
limslam_env {__version__}: a simulator of robots that explore unknown buildings with a few range sensors.

This package has no commands of its own.
  Python:   import gymnasium, limslam_env; env = gymnasium.make("LimSlam-Env1-v0")
  Shell:    limslam --help    (runs the agent, drives a robot by keyboard, lists worlds)
"""

if __name__ == "__main__":
    sys.stdout.write(TEXT)
