"""``python -m limslam_agent`` is the command ``limslam``, also where the shell does not find
that.
"""

from limslam_agent.cli.main import main

if __name__ == "__main__":
    main()
