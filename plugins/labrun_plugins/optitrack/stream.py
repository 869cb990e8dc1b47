"""The stream of one trial: frames in the order of their numbers, made into samples, or why they are no measurement."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labrun.devices import (
    Channel,
    Clock,
    DeviceError,
    FloatArray,
    OrientationAngles,
    SampleBuffer,
    turn_about,
)
from labrun_plugins.optitrack.frame import BITSTREAM_CHANGED, EDIT_MODE, MODELS_CHANGED, Frame
from labrun_plugins.optitrack.messages import dotted
from labrun_plugins.optitrack.session import Session
from labrun_plugins.optitrack.settings import OptiTrackSettings

_HOLD_S = 0.01
_HOLD_PERIODS = 1.5
_HOLD_MOST = 64
_WINDOW_S = 2.0
"""A number farther away than the frames of this time belongs to another count."""
_CLOSE = 5
_TOLD_S = 60.0
"""A longer time between two counts says that the clock is another one, too."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """A frame, when it was exposed by the server's clock, when it arrived, and how many were lost just before it."""

    frame: Frame
    exposed_s: float
    host_s: float
    lost: int = 0


class FrameOrder:
    """Puts frames in order.

    A frame whose number is next is handed on at once. One that is ahead waits for those between for a few periods;
    then they are lost. A number that fits neither the count nor the clock begins a new count if the next frame goes on
    from it, and is dropped as garbage if not.

    Attributes
    ----------
    stale
        Frames dropped as repeats, or as too late.
    restarts
        How often the count began anew.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._hold_s = max(_HOLD_S, _HOLD_PERIODS / rate_hz)
        self._window = int(_WINDOW_S * rate_hz) + 1
        self.stale = 0
        self.restarts = 0
        self._last: Arrival | None = None
        self._held: dict[int, Arrival] = {}
        self._suspect: Arrival | None = None

    def put(self, frame: Frame, exposed_s: float, host_s: float) -> list[Arrival]:
        """Take a frame; return what can be handed on now, in order."""
        new = Arrival(frame, exposed_s, host_s)
        last = self._last
        if last is None:
            return [self._pass(new, 0)]
        ahead = _signed(frame.number - last.frame.number - 1)
        if 0 <= ahead <= self._window:
            self._suspect = None
            if frame.number in self._held:
                self.stale += 1
                return []
            self._held[frame.number] = new
            return self._in_turn() + self.flush(host_s)
        late_s = last.exposed_s - exposed_s  # of another clock where it is longer than numbers so near take
        if -self._window <= ahead < 0 and -0.5 / self._rate_hz <= late_s <= _WINDOW_S:
            self.stale += 1
            return self.flush(host_s)
        return self._begin_anew(new)

    def flush(self, now_s: float) -> list[Arrival]:
        """Return the frames that have waited long enough for those before them."""
        ready: list[Arrival] = []
        while self._held and (
            len(self._held) > _HOLD_MOST
            or now_s - min(arrival.host_s for arrival in self._held.values()) > self._hold_s
        ):
            assert self._last is not None  # noqa: S101  nothing is held before the first frame
            base = self._last.frame.number + 1
            ahead, number = min((_signed(number - base), number) for number in self._held)
            ready.append(self._pass(self._held.pop(number), ahead))
            ready += self._in_turn()
        return ready

    def _in_turn(self) -> list[Arrival]:
        ready: list[Arrival] = []
        while self._last is not None:
            following = self._held.pop(_signed(self._last.frame.number + 1), None)
            if following is None:
                break
            ready.append(self._pass(following, 0))
        return ready

    def _begin_anew(self, new: Arrival) -> list[Arrival]:
        first, self._suspect = self._suspect, new
        if first is None or not 0 < _signed(new.frame.number - first.frame.number) <= _CLOSE:
            return []
        self._suspect = None
        self.restarts += 1
        ready = self.flush(float("inf"))
        assert self._last is not None  # noqa: S101  there is no new count before the first
        # Numbers of two counts say nothing of what lies between; the clock does, if it went on.
        away = round((first.exposed_s - self._last.exposed_s) * self._rate_hz) - 1
        ready.append(self._pass(first, away if 0 <= away <= _TOLD_S * self._rate_hz else 0))
        self._held[new.frame.number] = new
        return ready + self._in_turn()

    def _pass(self, arrival: Arrival, lost: int) -> Arrival:
        # A frame that waited arrives for the host no earlier than the one it waited for.
        host_s = arrival.host_s if self._last is None else max(arrival.host_s, self._last.host_s)
        self._last = Arrival(arrival.frame, arrival.exposed_s, host_s, lost)
        return self._last


def _signed(number: int) -> int:
    """Return a number of 32 bit as a signed one: counts wrap."""
    return (number + 2**31) % 2**32 - 2**31


_POSE = (("x", "m"), ("y", "m"), ("z", "m"), ("qx", "1"), ("qy", "1"), ("qz", "1"), ("qw", "1"))


def channels_of(settings: OptiTrackSettings) -> tuple[Channel, ...]:
    """Return what is measured, in the order of a sample: poses, angles, markers."""
    poses = [Channel(f"{body}_{part}", unit) for body in settings.bodies for part, unit in _POSE]
    places = [
        Channel(f"{body}_marker{number}_{part}", "m")
        for body in settings.bodies
        for number in range(1, settings.markers.get(body, 0) + 1)
        for part in "xyz"
    ]
    return (*poses, *BodyAngles(settings).channels, *places)


class BodyAngles:
    """All angles that the settings ask for: turns of a body, hinges between two, Euler angles.

    Attributes
    ----------
    channels
        In the order of `of`.
    """

    def __init__(self, settings: OptiTrackSettings) -> None:
        self._turns = [
            (settings.bodies.index(angle.body), np.array(angle.axis) / np.linalg.norm(angle.axis))
            for angle in settings.angles.values()
        ]
        self._between = OrientationAngles(settings.bodies, settings.joints, settings.euler)
        self.channels = (*(Channel(name, "rad") for name in settings.angles), *self._between.channels)

    def of(self, orientations: FloatArray) -> FloatArray:
        """Return the angles, shape (n, channels), of orientations (n, bodies, 4)."""
        turns = [turn_about(orientations[:, body], axis) for body, axis in self._turns]
        return np.column_stack([*turns, self._between.of(orientations)])


@dataclass(frozen=True, slots=True)
class Unseen:
    """Why a frame gives no sample: what was not measured in it."""

    body: str
    reason: str


class PoseReader:
    """Makes samples of frames."""

    def __init__(self, settings: OptiTrackSettings) -> None:
        self.channels = channels_of(settings)
        markers = settings.markers
        self._bodies = settings.bodies
        self._angles = BodyAngles(settings)
        self._markers = [
            (body, number) for body in self._bodies for number in range(1, markers.get(body, 0) + 1)
        ]
        self._ids: dict[str, int] = {}

    def bind(self, ids: Mapping[str, int]) -> None:
        """Take the numbers by which frames name the bodies."""
        self._ids = dict(ids)

    def sample(self, frame: Frame) -> FloatArray | Unseen:
        """Return the values of a frame, shape (channels,), or what was not measured in it."""
        bodies = {body.id: body for body in frame.bodies}
        poses = np.empty((len(self._bodies), 7))
        for row, name in enumerate(self._bodies):
            body = bodies.get(self._ids[name])
            if body is None:
                return Unseen(name, "is not in the frames")
            if not body.measured:
                return Unseen(name, "is not tracked")
            poses[row] = body.pose
        angles = self._angles.of(poses[None, :, 3:])[0]
        places: list[FloatArray] = []
        if self._markers:
            seen = {marker.id: marker for marker in frame.markers}
            for name, number in self._markers:
                marker = seen.get(self._ids[name] << 16 | number)
                if marker is None or not marker.measured:
                    return Unseen(name, f"has its marker {number} hidden")
                places.append(np.array(marker.position))
        return np.concatenate([poses.ravel(), angles, *places])


SEE_MARKERS = "see that cameras see its markers; lost_tracking_s says how long it may be lost"
"""What to do about a body that is not tracked."""
_SILENT_S = 0.4
_SILENT_PERIODS = 5.0
_DOUBT_S = 0.4
_CONNECT_EVERY_S = 0.2
_FAULT_WORDS = {
    EDIT_MODE: (
        "is in edit mode: what it streams is a recording, not a measurement",
        "switch Motive to Live, then labrun resume",
    ),
    BITSTREAM_CHANGED: (
        "changed the layout of its frames during the trial",
        "see that no other program or person changes Motive's bitstream version; labrun resume connects again",
    ),
}


class PoseStream:
    """Collects the samples of a trial; one thread puts frames, another takes samples and asks what is wrong.

    A frame in which one of the bodies (or a marker that was asked for) was not measured is no sample: it counts as
    lost, as does a frame that never arrived. Motive goes on to send the last pose of a body that it lost.

    Parameters
    ----------
    session, reader
        Where frames come from, and what makes samples of them.
    lost_tracking_s
        How long a body may be lost.

    Attributes
    ----------
    buffer
        Gets the samples.
    order
        Puts frames in order, and counts what was wrong with it.
    unmeasured
        Frames in which something was not measured.
    """

    def __init__(
        self,
        device: str,
        session: Session,
        reader: PoseReader,
        rate_hz: float,
        lost_tracking_s: float,
        clock: Clock,
    ) -> None:
        self._device = device
        self._session = session
        self._reader = reader
        self._rate_hz = rate_hz
        self._lost_tracking_s = lost_tracking_s
        self._clock = clock
        self.buffer = SampleBuffer(len(reader.channels))
        self.order = FrameOrder(rate_hz)
        self.unmeasured = 0
        self._models_changed = False
        self._fault: int = 0
        self._unseen: tuple[Unseen, float] | None = None
        self._heard_s = clock.now()
        self._connected_s = self._heard_s

    def put(self, frame: Frame, exposed_s: float, host_s: float) -> None:
        """Take a frame as it arrives."""
        self._heard_s = host_s
        before = self.order.restarts
        arrivals = self.order.put(frame, exposed_s, host_s)
        if self.order.restarts > before:
            self._session.doubt("server", "model")
        for arrival in arrivals:
            self._hand_on(arrival)

    def tick(self) -> None:
        """Let go of what has waited for frames that will not come; ask a silent server to serve."""
        now_s = self._clock.now()
        for arrival in self.order.flush(now_s):
            self._hand_on(arrival)
        quiet_s = now_s - max(self._heard_s, self._connected_s)
        if quiet_s > max(_CONNECT_EVERY_S, _SILENT_PERIODS / self._rate_hz):
            self._connected_s = now_s
            self._session.connect_again()

    def _hand_on(self, arrival: Arrival) -> None:
        if arrival.lost:
            self.buffer.count_lost(arrival.lost)
        params = arrival.frame.params
        changed = bool(params & MODELS_CHANGED)
        if changed and not self._models_changed:
            self._session.doubt("model")
        self._models_changed = changed
        fault = params & (EDIT_MODE | BITSTREAM_CHANGED)
        self._fault = self._fault or fault
        # a fault ends the stream: what comes after it is no sample either
        if self._fault or self._session.in_doubt:
            self._not_measured()
            return
        sample = self._reader.sample(arrival.frame)
        if isinstance(sample, Unseen):
            self._not_measured()
            if self._unseen is None or self._unseen[0] != sample:
                self._unseen = (sample, arrival.host_s if self._unseen is None else self._unseen[1])
            return
        self._unseen = None
        self.buffer.put(arrival.exposed_s, arrival.host_s, sample)

    def _not_measured(self) -> None:
        self.unmeasured += 1
        self.buffer.count_lost(1)

    def check(self) -> None:
        """Raise DeviceError if what comes is no measurement any more, or nothing comes."""
        now_s = self._clock.now()
        for bit, (message, hint) in _FAULT_WORDS.items():
            if self._fault & bit:
                raise DeviceError(self._device, message, hint=hint)
        if self._session.in_doubt and self._session.doubtful_for_s() > _DOUBT_S:
            raise DeviceError(
                self._device,
                "changed its bodies or restarted its frame count, and does not answer what it streams now",
                hint="look at Motive; labrun resume connects again",
            )
        quiet_s = now_s - self._heard_s
        if quiet_s > max(_SILENT_S, _SILENT_PERIODS / self._rate_hz):
            raise self._silence(quiet_s)
        unseen = self._unseen
        if unseen is not None and now_s - unseen[1] > self._lost_tracking_s:
            what, since_s = unseen
            raise DeviceError(
                self._device,
                f"body {what.body} {what.reason}, for {now_s - since_s:.2g} s now",
                hint=SEE_MARKERS,
            )

    def _silence(self, quiet_s: float) -> DeviceError:
        answers = self._clock.now() - self._session.answered_s < quiet_s
        if self._session.unreadable_in_a_row:
            size, version = len(self._session.sample), dotted(self._session.layout)
            return DeviceError(
                self._device,
                f"sends frames that do not fit NatNet {version} (the last has {size} bytes)",
                hint="a program changed Motive's bitstream, or the network cuts frames; labrun resume connects again",
            )
        cut = self._session.link.malformed
        return DeviceError(
            self._device,
            f"has sent no frame for {quiet_s:.2g} s (expected {self._rate_hz:g} frames/s)"
            + ("; it answers, though" if answers else ", nor does it answer")
            + (f"; {cut} datagrams were cut short" if cut else ""),
            hint="see that Motive is live and streams"
            if answers
            else "check Motive's computer, its network cable and its firewall, then labrun resume",
        )
