"""What the command line says about an option: the annotation of a field."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Help:
    """The panel of an option in the help, if there is one, and the help.

    ``default`` is the default in words, where it is not that of the field; False shows none.
    ``name`` is that of an option that does not have the name of the field.
    """

    panel: str | None
    words: str
    default: str | bool = True
    name: str | None = None
