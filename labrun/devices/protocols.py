"""What a device is: small structural protocols, one per capability; nothing to inherit."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Literal, Protocol, runtime_checkable

from labrun.devices.pacing import Pacing
from labrun.devices.samples import Channel, Samples
from labrun.devices.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class Identity:
    """What answered: stored with every run."""

    model: str
    serial: str = ""
    firmware: str = ""
    details: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Health:
    """How a device is, by its own account."""

    ok: bool = True
    temperature_c: float | None = None
    notes: tuple[str, ...] = ()


@runtime_checkable
class Device(Protocol):
    """What all devices share."""

    name: str

    def open(self) -> None:
        """Connect. Raises DeviceError with the next thing to try."""
        ...

    def identify(self) -> Identity:
        """Ask the device what it is."""
        ...

    def health(self) -> Health:
        """Ask the device how it is; every few seconds, also while it moves or streams."""
        ...

    def safe_stop(self) -> None:
        """Stop all motion. Any moment, any thread, any number of times; never raises."""
        ...

    def close(self) -> None:
        """Disconnect; harmless when not connected."""
        ...


@runtime_checkable
class Actuator(Device, Protocol):
    """Follows joint trajectories."""

    joints: tuple[str, ...]

    def pose(self) -> Mapping[str, float]:
        """Where each joint is, rad: measured if the device can, else where its command stands now."""
        ...

    def follow(self, trajectory: Trajectory, start_s: float) -> None:
        """Start following (columns = `joints`) at the clock's `start_s`; returns at once, then holds the last point."""
        ...


@runtime_checkable
class Paced(Actuator, Protocol):
    """An actuator that sends its set-points one after another, and knows how evenly."""

    def restart_pacing(self) -> None:
        """Forget how evenly set-points have gone out so far."""
        ...

    def pacing(self) -> Pacing:
        """Return how evenly set-points have gone out since `restart_pacing`, or since it was opened."""
        ...


@runtime_checkable
class Arranging(Device, Protocol):
    """A device that puts something of a trial's condition in place before anything moves: a slider of two states."""

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Say what the next trial's condition is; returns at once."""
        ...

    def arrived(self) -> bool:
        """Tell whether it is in place; asked again and again while the bench is watched.

        Raises
        ------
        DeviceError
            It does not get there.
        """
        ...


@runtime_checkable
class Attended(Arranging, Actuator, Protocol):
    """An actuator that is a person: wants to be told what to put in place, and says when it is there."""


@runtime_checkable
class Sensor(Device, Protocol):
    """Streams samples."""

    channels: tuple[Channel, ...]
    rate_hz: float

    def start(self) -> None:
        """Begin to stream; samples from before are dropped."""
        ...

    def read(self) -> Samples:
        """Return all samples since the last call; an empty block if there are none. Does not wait."""
        ...

    def stop(self) -> None:
        """End the stream."""
        ...


@runtime_checkable
class Tracker(Sensor, Protocol):
    """A sensor of poses: channels `<body>_x` ... `<body>_qw` for each body, and the joint angles asked for."""

    bodies: tuple[str, ...]


@runtime_checkable
class Carriage(Device, Protocol):
    """Moves the specimen along a straight line."""

    travel_m: tuple[float, float]

    def position_m(self) -> float:
        """Where the carriage is."""
        ...

    def travel(self, to_m: float, speed_m_s: float, acceleration_m_s2: float = ...) -> None:
        """Start a straight move at constant speed; returns at once.

        A carriage that can change its ramps takes `acceleration_m_s2`; what it does without is its own. One that
        cannot has no such parameter, and `trial.carriage.acceleration_m_s2` is refused for it.
        """
        ...


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
