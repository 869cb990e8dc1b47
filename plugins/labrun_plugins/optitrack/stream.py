"""The stream of one trial: frames put in order, made into samples, and told when they are no measurement."""

from labrun.devices import Clock, DeviceError, SampleBuffer
from labrun_plugins.optitrack.frame import BITSTREAM_CHANGED, EDIT_MODE, MODELS_CHANGED, Frame
from labrun_plugins.optitrack.messages import dotted
from labrun_plugins.optitrack.order import Arrival, FrameOrder
from labrun_plugins.optitrack.poses import PoseReader, Unseen
from labrun_plugins.optitrack.session import Session

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
        "see that no other program or person changes Motive's bitstream version; labrun resume connects anew",
    ),
}


class PoseStream:
    """Collects the samples of a trial; one thread puts frames, another takes samples and asks what is wrong.

    A frame in which one of the bodies (or a marker that was asked for) was not measured is no sample: it counts as
    lost, as does a frame that never arrived. Motive goes on to send the last pose of a body that it lost.

    Parameters
    ----------
    device
        Its name in the experiment file.
    session, reader
        Where frames come from, and what makes samples of them.
    rate_hz
        Frames a second.
    lost_tracking_s
        How long a body may be lost.
    clock
        The run's clock.

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
        if (
            self._fault or self._session.in_doubt
        ):  # a fault ends the stream: what comes after it is no sample either
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
                "changed its bodies or began to count frames anew, and does not answer what it streams now",
                hint="look at Motive; labrun resume connects anew",
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
                hint="see that cameras see its markers, and nothing else that shines; lost_tracking_s says how long "
                "is too long",
            )

    def _silence(self, quiet_s: float) -> DeviceError:
        answers = self._clock.now() - self._session.answered_s < quiet_s
        if self._session.unreadable_in_a_row:
            size, version = len(self._session.sample), dotted(self._session.layout)
            return DeviceError(
                self._device,
                f"sends frames that do not fit NatNet {version} (the last has {size} bytes)",
                hint="a program changed Motive's bitstream, or the network cuts frames; labrun resume connects anew",
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
