"""Parts of the sentences in which readers of logs say what they have found."""

from collections.abc import Sequence


def listed(words: Sequence[str], most: int) -> str:
    """The first words of a list, and how many more there are."""
    more = f" and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(words[:most]) + more


def was(count: int) -> str:
    """The verb behind so many things."""
    return "was" if count == 1 else "were"
