"""OptiTrack motion capture through Motive's NatNet stream."""

from typing import ClassVar

from labrun.devices import (
    Clock,
    DeviceContext,
    DeviceError,
    DeviceSettings,
    Health,
    Identity,
    Listener,
    Remark,
    Samples,
    opened,
    streaming,
)
from labrun_plugins.optitrack.frame import BITSTREAM_CHANGED, EDIT_MODE, Frame
from labrun_plugins.optitrack.handshake import Handshake
from labrun_plugins.optitrack.messages import dotted
from labrun_plugins.optitrack.session import Session
from labrun_plugins.optitrack.settings import OptiTrackSettings
from labrun_plugins.optitrack.stream import PoseReader, PoseStream

_SLOW_S = 0.02
_FAR_S = 0.005


def remarks(device: str, settings: OptiTrackSettings, session: Session, frame: Frame | None) -> list[Remark]:
    """Return remarks on rate, axes, layout, network, latency and the bodies in view."""
    checks = [_rate(device, settings, session), _axis(device, settings), _layout(device, session)]
    checks += _latency(device, session, frame)
    checks += _bodies(device, settings, session, frame)
    return checks


def _rate(device: str, settings: OptiTrackSettings, session: Session) -> Remark:
    if session.rate_hz is None:
        return Remark(
            "warning",
            device,
            "Motive does not tell its frame rate",
            f"see that it is {settings.rate_hz:g} frames/s",
        )
    return Remark("ok", device, f"{session.rate_hz:g} frames/s, as the file says")


def _axis(device: str, settings: OptiTrackSettings) -> Remark:
    if settings.up_axis is None:
        return Remark(
            "warning",
            device,
            "which axis points up is not stated, and NatNet does not tell",
            'see Up Axis in Motive\'s streaming pane, and add it to the file: up_axis = "y"',
        )
    return Remark("ok", device, f"axis {settings.up_axis} points up, as the file states")


def _layout(device: str, session: Session) -> Remark:
    version = dotted(session.layout)
    how = "multicast" if session.multicast else "unicast"
    if session.link.foreign:
        return Remark(
            "warning",
            device,
            f"{session.link.foreign} datagrams of {session.link.foreign_address} were ignored",
            "another server streams on this network; give it another group or port",
        )
    return Remark("ok", device, f"frames of NatNet {version} by {how} on interface {session.local}")


def _latency(device: str, session: Session, frame: Frame | None) -> list[Remark]:
    checks = []
    latency_s = None if frame is None else session.latency_s(frame)
    if latency_s is not None:
        text = f"{1e3 * latency_s:.1f} ms from exposure to transmission"
        advice = "close views and programs on Motive's computer"
        checks.append(Remark.judged(latency_s <= _SLOW_S, device, text, advice))
    offset = session.echoes.best()
    if offset is not None:
        text = f"clock offset {offset.offset_s:.4f} s, known to {1e3 * offset.round_trip_s / 2:.2f} ms"
        near = offset.round_trip_s <= _FAR_S
        checks.append(Remark.judged(near, device, text, "connect by cable, not by wireless"))
    return checks


def _bodies(device: str, settings: OptiTrackSettings, session: Session, frame: Frame | None) -> list[Remark]:
    numbers = {body.name: body.id for body in session.bodies}
    measured = {} if frame is None else {body.id: body for body in frame.bodies if body.measured}
    bodies = []
    for name in settings.bodies:
        body = measured.get(numbers.get(name, -1))
        if body is None:
            advice = "see that cameras see its markers, and that it is switched on in Motive's assets pane"
            bodies.append(Remark("problem", device, f"body {name} is not tracked now", advice))
        else:
            bodies.append(
                Remark("ok", device, f"body {name} is tracked, markers fit to {1e3 * body.error_m:.2f} mm")
            )
    return bodies


_RATE_SLACK = 0.01
_FIRST_FRAME_S = 2.0
_QUIET_S = 1.0


class OptiTrack:
    """Rigid bodies, joint angles and markers as Motive streams them."""

    Settings: ClassVar[type[DeviceSettings]] = OptiTrackSettings

    def __init__(self, name: str, settings: OptiTrackSettings, context: DeviceContext) -> None:
        self.name = name
        self.rate_hz = settings.rate_hz
        self.bodies = settings.bodies
        self._settings = settings
        self._clock: Clock = context.clock
        self._reader = PoseReader(settings)
        self.channels = self._reader.channels
        self._session: Session | None = None
        self._listener = Listener(name, self._receive)
        self._stream: PoseStream | None = None
        self._latest: tuple[Frame, float] | None = None
        self._bound = 0

    def open(self) -> None:
        """Connect to Motive, and see that it streams the bodies of the file at their rate.

        Raises DeviceError: no answer, another rate, a body that Motive does not stream, or no frames.
        """
        self.close()
        session = self._session = Session(self.name, self._settings, self._clock)
        try:
            Handshake(self.name, self._settings, self._clock, session).perform()
            self._check_rate(session)
            self._bind(session)
            self._await_frame(session)
        except BaseException:
            self.close()
            raise
        self._listener.start()

    def identify(self) -> Identity:
        """Say which Motive answered, and all that its data mean depends on."""
        session = self._require_open()
        info = session.info
        assert info is not None  # noqa: S101  an open session knows its server
        latest = None if self._latest is None else session.latency_s(self._latest[0])
        offset = session.echoes.best()
        details = {
            "natnet": dotted(info.natnet),
            "bitstream": dotted(session.layout),
            "transmission": "multicast" if session.multicast else "unicast",
            "interface": session.local,
            "rate_hz": "not told" if session.rate_hz is None else f"{session.rate_hz:g}",
            "up_axis": self._settings.up_axis or "not stated",
            "bodies": ", ".join(f"{name} = {number}" for name, number in self._ids(session).items()),
            "device_time": "mid-exposure ticks" if info.clock_hz else "software clock of Motive",
        }
        if info.clock_hz is not None:
            details["clock_hz"] = str(info.clock_hz)
        if latest is not None:
            details["latency_in_motive_s"] = f"{latest:.6f}"
        if offset is not None:
            details["clock_offset_s"] = f"{offset.offset_s:.6f}"
            details["echo_round_trip_s"] = f"{offset.round_trip_s:.6f}"
        return Identity(f"OptiTrack, {info.name}", "", f"{info.name} {dotted(info.app)}", details)

    def health(self) -> Health:
        """Say whether frames come, and what was dropped of them."""
        session = self._session
        if session is None:
            return Health(ok=False, notes=("not connected",))
        trouble = self._trouble()
        return Health(ok=False, notes=(trouble,)) if trouble else Health(notes=self._notes(session))

    def examine(self) -> list[Remark]:
        """Return what a look at Motive's set-up brings up."""
        session = self._require_open()
        return remarks(self.name, self._settings, session, None if self._latest is None else self._latest[0])

    def start(self) -> None:
        """Begin to collect samples; frames from before are dropped.

        Raises DeviceError: not open, or the connection broke in the meantime.
        """
        session = self._require_open()
        self._listener.check()
        self._stream = PoseStream(
            self.name, session, self._reader, self.rate_hz, self._settings.lost_tracking_s, self._clock
        )

    def read(self) -> Samples:
        """Return all samples since the last call; does not wait.

        Raises DeviceError: not streaming; or, once everything that came has been handed over: no frames, frames that
        are no measurement, a body that is not tracked.
        """
        self._require_open()
        stream = streaming(self.name, self._stream)
        block = self._listener.deliver(stream.buffer)
        if not len(block):
            stream.check()
        return block

    def stop(self) -> None:
        """End collecting; Motive goes on to stream."""
        self._stream = None

    def safe_stop(self) -> None:
        """Nothing to stop: cameras only look."""

    def close(self) -> None:
        """Disconnect; harmless when not connected."""
        self._stream = None
        self._listener.stop()
        session, self._session = self._session, None
        if session is not None:
            session.close()
        self._latest = None
        self._bound = 0

    def _receive(self) -> None:
        """Take what has arrived; called again and again by the listening thread."""
        session, stream = self._session, self._stream
        if session is None:
            return
        frames = session.pump()
        if session.models != self._bound:
            self._bind(session)
        for frame, host_s in frames:
            self._latest = (frame, host_s)
            if stream is not None:
                stream.put(frame, session.exposed_s(frame), host_s)
        if stream is not None:
            stream.tick()

    def _bind(self, session: Session) -> None:
        self._bound = session.models
        self._reader.bind(self._ids(session))

    def _ids(self, session: Session) -> dict[str, int]:
        ids = {body.name: body.id for body in session.bodies}
        missing = [name for name in self.bodies if name not in ids]
        if missing:
            raise DeviceError(
                self.name,
                f"Motive streams no rigid body {', '.join(missing)}",
                hint=f"it streams {', '.join(sorted(ids)) or 'none'}; bodies are named as in Motive's assets pane, "
                "where each must be switched on",
            )
        return {name: ids[name] for name in self.bodies}

    def _check_rate(self, session: Session) -> None:
        stated_hz = session.rate_hz
        if stated_hz is not None and abs(stated_hz - self.rate_hz) > _RATE_SLACK * self.rate_hz:
            raise DeviceError(
                self.name,
                f"Motive runs at {stated_hz:g} frames/s, and the file says rate_hz = {self.rate_hz:g}",
                hint="change the camera rate in Motive's devices pane, or rate_hz in the file",
            )

    def _await_frame(self, session: Session) -> None:
        deadline_s = self._clock.now() + _FIRST_FRAME_S
        session.unreadable_in_a_row = 0
        while self._clock.now() < deadline_s:
            frames = session.pump()
            if frames:
                self._latest = frames[-1]
                return
        link = session.link
        if session.unreadable_in_a_row:
            raise DeviceError(
                self.name,
                f"sends frames that do not fit NatNet {dotted(session.layout)} "
                f"(the last has {len(session.sample)} bytes)",
                hint='state the layout that Motive streams, for example bitstream = "3.0"',
            )
        elsewhere = f"; frames of {link.foreign_address} are ignored" if link.foreign else ""
        how = "multicast" if session.multicast else "unicast"
        raise DeviceError(
            self.name,
            f"Motive answers, but no {how} frame came to interface {session.local} "
            f"in {_FIRST_FRAME_S:g} s{elsewhere}",
            hint="see that Motive is live and its streaming pane names the interface that leads here; a firewall "
            "may hold frames back; unicast passes more networks than multicast",
        )

    def _require_open(self) -> Session:
        return opened(self.name, self._session)

    def _trouble(self) -> str:
        """Return why nothing that comes is a measurement; empty if it is."""
        try:
            self._listener.check()
        except DeviceError as error:
            return str(error)
        if self._latest is None:
            return "no frame yet"
        frame, host_s = self._latest
        quiet_s = self._clock.now() - host_s
        if quiet_s > _QUIET_S:
            return f"no frame for {quiet_s:.2g} s: see that Motive is live and streams"
        if frame.params & EDIT_MODE:
            return "Motive is in edit mode: switch it to Live"
        if frame.params & BITSTREAM_CHANGED:
            return "the layout of the frames was changed in Motive"
        return ""

    def _notes(self, session: Session) -> tuple[str, ...]:
        stream, link = self._stream, session.link
        counts = [
            (0 if stream is None else stream.unmeasured, "frames without a measurement of every body"),
            (0 if stream is None else stream.order.stale, "frames repeated or too late"),
            (0 if stream is None else stream.order.restarts, "times frames were counted anew"),
            (session.unreadable + link.malformed, "datagrams cut short or unreadable"),
            (link.foreign, f"datagrams of others ({link.foreign_address})"),
        ]
        return tuple(f"{count} {what}" for count, what in counts if count)
