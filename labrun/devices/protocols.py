"""Structural protocols of devices, one per capability; of their plugins; and of scenes."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any, ClassVar, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np

from labrun.arrays import FloatArray
from labrun.devices.clock import Clock
from labrun.devices.limits import Limits
from labrun.devices.pacing import Pacing
from labrun.devices.samples import Channel, Samples
from labrun.devices.trajectory import Trajectory
from labrun.errors import DeviceError
from labrun.toml import Keys


class Scene(Protocol):
    """A simulated bench. Its time is the clock's; it moves on when it is observed.

    A scene on which mountings differ also has ``mount(number)``: called after each `arrange` with the number of the
    mounting, where something is set by hand. The same number is the same mounting. One on which something happens by
    itself during a trial has ``begin(start_s)``: called with the clock's time at which the recording begins.

    One in front of which a person would read something off has ``answer(what)``: called after a trial, it returns the
    number or the word that the person would type.

    One that has to agree with a model whose servos take no steps is ``smooth_drives``: stand-ins of servos then follow
    what they are told without frames, steps and dead band, as late as with them.
    """

    signals: Mapping[str, str]
    """What can be felt or seen: signal name -> SI unit, for example ``{"force_x": "N"}``."""

    joints: tuple[str, ...]
    """What can be driven."""

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Put in place what a person would change by hand between trials (a specimen, a mass)."""
        ...

    def drive(self, joint: str, trajectory: Trajectory, start_s: float) -> None:
        """Command one joint (a trajectory of that joint alone) from the clock's `start_s` on."""
        ...

    def tow(
        self, from_m: float, to_m: float, speed_m_s: float, start_s: float, acceleration_m_s2: float = ...
    ) -> None:
        """Move the carriage along its line at constant speed from `start_s` on.

        A scene with ramps takes `acceleration_m_s2`, and has a value of its own for moves that do not say.
        """
        ...

    def observe(self, signals: Sequence[str], time_s: FloatArray) -> FloatArray:
        """Return the true signals at these times, shape (n, signals), advancing the physics as needed.

        Times ascend, and lie at most a few seconds before the latest time observed by anyone.
        """
        ...

    def snapshot(self) -> dict[str, Any]:
        """Return the whole memory of the bench as JSON-ready values, so that a resumed run goes on identically.

        Kept with every trial: what is over for more than a few seconds has no place in it.
        """
        ...

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Take back what `snapshot` gave."""
        ...

    def truth(self) -> dict[str, Any]:
        """Return parameters and hidden effects as JSON-ready values: stored sealed, never shown by a diagnosis."""
        ...


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


Part = TypeVar("Part")


def opened(device: str, part: Part | None) -> Part:
    """Return an attribute of an open device. Raises DeviceError: it is None.

    Raises DeviceError: it is None, or False where a device only notes whether it is open.
    """
    if part is None or part is False:
        raise DeviceError(device, "is not open", hint="open() comes before any other call")
    return part


def streaming(device: str, part: Part | None) -> Part:
    """Return what a sensor has while it streams. Raises DeviceError: it is None or False."""
    if part is None or part is False:
        raise DeviceError(device, "is not streaming", hint="start() comes before read()")
    return part


@runtime_checkable
class Device(Protocol):
    """What all devices share."""

    name: str

    def open(self) -> None:
        """Connect. Raises DeviceError with the next thing to try."""
        ...

    def identify(self) -> Identity:
        """Return the identity of the device."""
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
        """Return the angle of each joint, rad: measured, else commanded."""
        ...

    def follow(self, trajectory: Trajectory, start_s: float) -> None:
        """Start following (columns = `joints`) at the clock's `start_s`; returns at once, then holds the last point."""
        ...


@runtime_checkable
class Paced(Actuator, Protocol):
    """An actuator that streams set-points and records their timing."""

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
        """Announce the condition of the next trial; returns at once."""
        ...

    def arrived(self) -> bool:
        """Tell whether everything is in place; polled while the bench is monitored.

        Raises
        ------
        DeviceError
            It does not get there.
        """
        ...


@runtime_checkable
class Attended(Arranging, Actuator, Protocol):
    """An actuator that is a person, who is told what to put in place and confirms it."""


@runtime_checkable
class Sensor(Device, Protocol):
    """Streams samples.

    One of forces or torques that needs no tare, because a calibration or a bias takes its offset off or because its
    values are computed, has ``zero_known = True``: `labrun check` then does not ask for one.
    """

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

    @classmethod
    def judged(
        cls,
        good: bool,
        subject: str,
        message: str,
        advice: str,
        bad: Literal["warning", "problem"] = "warning",
    ) -> "Remark":
        """Return a message that is "ok" where all is good, and `bad` with the advice where it is not."""
        return cls("ok", subject, message) if good else cls(bad, subject, message, advice)

    def to_json(self) -> dict[str, str]:
        """Return the fields by name."""
        return asdict(self)


class DeviceSettings(Keys):
    """What every device of an experiment file may say; a plugin's own settings extend it.

    A field of type `Port` is checked to exist before a run on hardware.
    """

    example: ClassVar[str] = ""
    """Keys to start from, in TOML with comments: what `labrun new` writes for the device."""

    limits: Limits = Limits()


Port = Annotated[str, "port"]
"""A serial port or network address."""


@dataclass(frozen=True, slots=True)
class DeviceContext:
    """What a device gets from the run it is part of.

    Attributes
    ----------
    clock
        All waiting and all time stamps go through it.
    rng
        The device's own generator, derived from the run's seed; re-seeded per trial by the runner through
        `reseed` where a device has that method, so that a resumed run repeats itself exactly.
    scene
        The simulated bench; None on hardware.
    """

    clock: Clock
    rng: np.random.Generator
    scene: Scene | None = None


class DevicePlugin(Protocol):
    """The class an entry point of group ``labrun.devices`` names.

    `stand_in` is the plugin that takes its place in a dry run; without it, ``simulated-<name>`` is looked for.
    """

    Settings: ClassVar[type[DeviceSettings]]

    def __call__(self, name: str, settings: Any, context: DeviceContext) -> Device:
        """Make the device; connects nothing."""
        ...


class EmergencyStop(Protocol):
    """What an actuator's plugin class offers to the watchdog, which runs in another process."""

    def emergency_stop(self, name: str, settings: Any) -> None:
        """Connect from scratch and stop all motion (a class method): the runner is dead or hangs."""
        ...
