"""Faults that show only when several keys are seen together, collected so that all are reported."""

from types import TracebackType

from pydantic_core import PydanticCustomError


class Faults:
    """Collects faults of a table inside a pydantic validator, and raises them together when the block ends."""

    def __init__(self) -> None:
        self._found: list[tuple[tuple[str, ...], str, tuple[str, ...] | None]] = []

    def add(
        self, key: str | tuple[str, ...] | None, message: str, *, of: tuple[str, ...] | None = None
    ) -> None:
        """Note a fault at a key of the table (None: at the table itself).

        `of` are the keys that the rule looks at: once one of them has been refused, the rule says nothing new. None
        stands for all keys of the table.
        """
        path = () if key is None else (key,) if isinstance(key, str) else key
        self._found.append((path, message, of))

    def __enter__(self) -> "Faults":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None and self._found:
            text = "; ".join(
                ".".join([*path, ""])[:-1] + (": " if path else "") + message
                for path, message, _ in self._found
            )
            raise PydanticCustomError("spec_faults", "{text}", {"text": text, "faults": list(self._found)})
