"""How a fit says what it is doing."""

from collections.abc import Callable

Note = Callable[[str], None]
"""Told, in a few words, what is being done now."""


def silent(_: str) -> None:
    """Say nothing."""
