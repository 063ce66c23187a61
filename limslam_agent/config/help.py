"""What the command line says about an option: the annotation of a field."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Help:
    """The panel of an option in the help, and the help.

    ``default`` is the default in words, where it is not that of the field; False shows none.
    ``name`` is that of an option that does not have the name of the field.
    """

    panel: str
    words: str
    default: str | bool = True
    name: str | None = None
