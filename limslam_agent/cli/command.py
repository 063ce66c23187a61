"""Commands in Python, as in a notebook."""

import shlex

import typer


def command(words: str) -> None:
    """Carry out a command of ``limslam`` in this process. In a notebook, it shows its pictures.

    Parameters
    ----------
    words
        What stands behind ``limslam`` on the command line. Words with spaces are quoted.

    Raises
    ------
    ValueError
        If the command does not exist, or is refused.

    Examples
    --------
    >>> from limslam_agent import command
    >>> command("worlds check env1")
    env1: 7 x 7 m, 12 walls, 1 obstacle, 0 doors, 2 starts, 44.4 m^2 of floor within reach
    """
    from limslam_agent.cli.main import app

    try:
        app(shlex.split(words), prog_name="limslam", standalone_mode=False)
    except typer.TyperException as error:
        raise ValueError(error.format_message()) from error
