"""``python -m limslam_agent``: says what this package is and which command to use."""

import sys

TEXT = """\
limslam_agent maps and explores unknown buildings with a differential-drive robot that has a few range beams.
Use it from Python (help(limslam_agent) lists the public names) or from the command line:

    limslam run       simulate a run of the agent and write its results
    limslam replay    build a map from a recorded log
    limslam --help    list all commands
"""


def main() -> None:
    """Print the text."""
    sys.stdout.write(TEXT)


if __name__ == "__main__":
    main()
