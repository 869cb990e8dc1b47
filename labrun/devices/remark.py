"""What a look at a device's set-up brought up, for `labrun doctor --hardware`."""

from dataclasses import asdict, dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Remark:
    """One thing that was looked at, what was found, and what to do about it."""

    verdict: Literal["ok", "warning", "problem"]
    subject: str
    message: str
    advice: str = ""

    def to_json(self) -> dict[str, str]:
        """Return the fields by name."""
        return asdict(self)
