"""``limslam notebooks``: the tutorials as notebooks."""

from pathlib import Path
from typing import Annotated

import typer

from limslam_agent.cli.options import Overwrite
from limslam_agent.terminal import say


def notebooks(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the notebooks.")],
    *,
    force: Overwrite = False,
) -> None:
    """Write the tutorials as notebooks for Jupyter, VS Code and Colab."""
    from limslam_agent.notebooks import write_notebooks

    say(*(f"written     {path}" for path in write_notebooks(folder, force=force)))
