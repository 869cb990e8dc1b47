"""The board's answer to ``ST``."""

from dataclasses import dataclass
from typing import Self

from labrun.devices import DeviceError

RESTING, MOVING, WATCHDOG, FAULT = range(4)
"""States: at its set-points, on its way to them, stopped by the watchdog, outputs off because of the hardware."""
_COMPLAINTS = {
    WATCHDOG: "its watchdog has expired: it stopped by itself",
    FAULT: "it turned its outputs off: over-current or supply",
}


@dataclass(frozen=True, slots=True)
class Status:
    """State, pulse width of each channel (us), and the board's milliseconds since its start."""

    state: int
    pulses_us: tuple[int, ...]
    millis: int

    @classmethod
    def parse(cls, device: str, fields: tuple[str, ...], channels: int) -> Self:
        """Return what the fields behind ``OK,ST`` say; DeviceError if they are not as they should be."""
        try:
            state, *pulses_us, millis = (int(field) for field in fields)
            if len(pulses_us) != channels:
                raise ValueError(f"{len(pulses_us)} pulse widths")
        except ValueError as error:
            raise DeviceError(
                device,
                f"its status says {','.join(fields)!r}; state, {channels} pulse widths and a time were expected",
                hint="flash the firmware that stands in the plugin's folder",
            ) from error
        return cls(state, tuple(pulses_us), millis)

    @property
    def complaints(self) -> tuple[str, ...]:
        """What is wrong; empty if nothing is."""
        if self.state in {RESTING, MOVING}:
            return ()
        return (_COMPLAINTS.get(self.state, f"it is in a state {self.state} that this driver does not know"),)
