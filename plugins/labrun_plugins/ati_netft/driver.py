"""An ATI force/torque sensor on a Net F/T box: RDT over UDP.

The default client is this package's own. The library pynetft (2.1.3 was looked at) streams 7000 samples a second
without loss, stamps them by the monotonic clock, and is there as ``client = "pynetft"``. It is not the default because
it throws away records that were overtaken on the way although they arrived, delivers nothing any more after the box
has begun its numbering anew, cannot be bound to an interface, takes no buffered datagrams, and makes a Python object of
every sample, which costs the interpreter several times as much as a block of them in one array.
"""

from collections.abc import Iterator
from contextlib import suppress
from typing import ClassVar

from labrun.devices import (
    SIX_AXES,
    Clock,
    DeviceContext,
    DeviceError,
    DeviceSettings,
    Health,
    Identity,
    ListeningSensor,
    Remark,
    listened,
    opened,
)
from labrun_plugins.ati_netft import codec, network, units
from labrun_plugins.ati_netft.network import BoxInfo, ask_status, box_rate
from labrun_plugins.ati_netft.pynetft_source import PynetftSource
from labrun_plugins.ati_netft.reception import Reception
from labrun_plugins.ati_netft.settings import AtiNetFtSettings
from labrun_plugins.ati_netft.source import BoxSource, DatagramSocket, Source

_RATE_TOLERANCE = 0.02
_ENOUGH_S = 0.3


def stream(
    reception: Reception, counted: str, info: BoxInfo, settings: AtiNetFtSettings, rate_hz: float
) -> Iterator[Remark]:
    """Judge what has been heard for a while.

    `counted`: what is said about the records. `rate_hz`: of the samples that are handed over.
    """
    counts, measured, stated_hz = reception.sequencer.counts, reception.rate_hz(), info.rate_hz
    if abs(measured / stated_hz - 1.0) > _RATE_TOLERANCE:
        advice = f"look at the RDT output rate on http://{settings.host}/comm.htm, and for another program"
        yield Remark("warning", "rate", f"says {stated_hz:g} samples/s, sends {measured:.5g}", advice)
    else:
        yield Remark("ok", "rate", f"{measured:.5g} records/s; {rate_hz:g} samples/s are handed over")
    advice = (
        'a network port of its own for the box, without a switch shared with others; or mode = "buffered"'
    )
    yield Remark.judged(not (counts.lost or counts.restarts), "losses", counted, advice)
    word = reception.last_status
    if word & codec.CONDITION:
        advice = f"clear it on http://{settings.host}/moncon.htm, or switch monitor conditions off"
        yield Remark("warning", "status", codec.words(word), advice)
    else:
        advice = "unload the sensor; check its cable to the box"
        yield Remark.judged(not word, "status", codec.words(word), advice, "problem")


def box(name: str, clock: Clock, info: BoxInfo, settings: AtiNetFtSettings, own: str) -> Iterator[Remark]:
    """Look at the buffer here, and hold what the box says by HTTP against TCP; `own` is this computer's address."""
    yield _buffer(name, clock, info, settings, own)
    yield _units(info, settings)
    yield from _tcp(info, settings, own)


def _buffer(name: str, clock: Clock, info: BoxInfo, settings: AtiNetFtSettings, own: str) -> Remark:
    socket = DatagramSocket(name, clock, own, (settings.host, settings.rdt_port))
    holds_s = socket.capacity() / info.rate_hz
    socket.close()
    message = f"the system holds {holds_s:.2g} s of records while this program is busy"
    return Remark.judged(holds_s >= _ENOUGH_S, "buffer", message, "sudo sysctl -w net.core.rmem_max=4194304")


def _units(info: BoxInfo, settings: AtiNetFtSettings) -> Remark:
    stated = (
        f"{info.counts_per_force:g} counts per {info.force_unit}, "
        f"{info.counts_per_torque:g} per {info.torque_unit}; range as of {settings.calibration}"
    )
    return Remark("ok", "units", stated, "compare with the calibration certificate")


def _tcp(info: BoxInfo, settings: AtiNetFtSettings, own: str) -> Iterator[Remark]:
    where = f"TCP port {settings.tcp_port}"
    try:
        answer = network.ask_tcp(settings, own, codec.calibration_request(), codec.CALINFO_BYTES)
        reading = network.ask_tcp(settings, own, codec.read_ft_request(), codec.READFT_BYTES)
    except OSError as error:
        yield Remark(
            "warning", where, f"no answer: {error}", "older boxes have none; labrun does not need it"
        )
        return
    calibration, decoded = codec.decode_calibration(answer), codec.decode_reading(reading)
    if calibration is None or decoded is None:
        yield Remark("warning", where, "its answer makes no sense", "update the box's firmware")
        return
    force = units.unit_of_code(units.FORCE_CODES, calibration.force_unit)
    torque = units.unit_of_code(units.TORQUE_CODES, calibration.torque_unit)
    agrees = (
        units.newtons_per(force) == units.newtons_per(info.force_unit)
        and units.newton_metres_per(torque) == units.newton_metres_per(info.torque_unit)
        and calibration.counts_per_force == info.counts_per_force
        and calibration.counts_per_torque == info.counts_per_torque
    )
    stated = f"{calibration.counts_per_force} counts per {force or 'unknown unit'}, "
    stated += f"{calibration.counts_per_torque} per {torque or 'unknown unit'}; {codec.words(decoded.status)}"
    advice = "its web page and its TCP port disagree about units: choose the calibration again and restart it"
    yield Remark.judged(agrees, where, stated, advice, "problem")


_NEAR_END = 0.9
_LISTEN_S = 1.0


class AtiNetFt(ListeningSensor):
    """Six axes, N and N m, at up to 7000 samples/s.

    Units and counts per unit are read from the box at `open`. The device time is the box's own count of its samples,
    divided by 7000 Hz. Nothing is zeroed here: the box's bias command is never sent (on a running stream it would spoil
    the numbering, and the raw data with it); the runner's tare is stored beside the raw data.
    """

    Settings: ClassVar[type[DeviceSettings]] = AtiNetFtSettings

    def __init__(self, name: str, settings: AtiNetFtSettings, context: DeviceContext) -> None:
        super().__init__(name, SIX_AXES, box_rate(settings.rate_hz), context.clock)
        self.settings = settings
        self.own = ""
        self._info: BoxInfo | None = None
        self._decimation = 1
        self._source: Source | None = None
        self._reception: Reception | None = None

    @property
    def info(self) -> BoxInfo:
        """What the box said about itself at `open`; DeviceError before."""
        return opened(self.name, self._info)

    @property
    def reception(self) -> Reception | None:
        """The stream that runs; None if none does."""
        return self._reception

    def open(self) -> None:
        """Connect: read the box's units and rate, set the rate if the file says so, and ask for one sample.

        Raises DeviceError: no way to it, no answer, an answer that makes no sense, a rate below the one wanted, or an
        error it reports.
        """
        self.close()
        own = network.own_address(self.name, self.settings)
        asking = network.set_rate if self.settings.set_rate else network.ask_info
        info = asking(self.name, self.settings, own)
        wanted_hz = box_rate(self.settings.rate_hz)
        if info.rate_hz < 0.999 * wanted_hz:
            raise DeviceError(
                self.name,
                f"the box sends {info.rate_hz:g} samples/s, but rate_hz = {self.settings.rate_hz:g}",
                hint="set_rate = true has labrun set the box's rate; or give a lower rate_hz",
            )
        self._require_well(ask_status(self.name, self.settings, self.clock, own))
        self._decimation = max(1, round(info.rate_hz / wanted_hz))
        self.own, self._info = own, info
        self.rate_hz = info.rate_hz / self._decimation

    def identify(self) -> Identity:
        """Return what it said at `open`, and how its samples are made into numbers."""
        info = self.info
        return Identity(
            model=info.product,
            serial=info.serial,
            details={
                "calibration": self.settings.calibration,
                "counts_per_force_unit": f"{info.counts_per_force:g}",
                "counts_per_torque_unit": f"{info.counts_per_torque:g}",
                "force_unit": info.force_unit,
                "torque_unit": info.torque_unit,
                "box_rate_hz": f"{info.rate_hz:g}",
                "rate_hz": f"{self.rate_hz:g}",
                "decimation": f"one record in {self._decimation} is kept, all are checked"
                if self._decimation > 1
                else "none",
                "mode": self.settings.mode,
                "client": self.settings.client,
                "own_address": self.own,
                "run_status": info.run_status,
                "software_bias": "not sent by labrun",
            },
        )

    def health(self) -> Health:
        """Report on the stream; if there is none, ask for one sample, to see that the box answers and is well.

        Raises DeviceError: the stream is lost, or it does not answer.
        """
        if self._info is None:
            return Health(ok=False, notes=("not connected",))
        reception, source = self._reception, self._source
        if reception is None or source is None:
            word = ask_status(self.name, self.settings, self.clock, self.own)
            self._require_well(word)
            return Health(notes=(codec.words(word),))
        self._check()
        counts = reception.sequencer.counts
        notes = [
            f"{counts.received} records at {reception.rate_hz():.5g} Hz, {counts.lost} lost "
            f"({source.dropped()} of them in this computer), {counts.repeated} repeated, {counts.overtaken} overtaken, "
            f"{source.malformed} malformed, {counts.restarts} restarts of the stream",
            codec.words(reception.last_status),
        ]
        if reception.saturated:
            notes.append(f"{reception.saturated} records saturated")
        if reception.conditions:
            notes.append("a monitor condition tripped: clear it on the box's web page")
        peak, reception.peak = reception.peak, reception.peak * 0.0
        notes += [
            f"{channel.name} has reached {100 * share:.0f} % of the range of {self.settings.calibration}"
            for channel, share in zip(SIX_AXES, peak, strict=True)
            if share > _NEAR_END
        ]
        return Health(notes=tuple(notes))

    def start(self) -> None:
        """Begin to stream; samples from before are dropped.

        Raises DeviceError: not open, or the box cannot be reached.
        """
        info = self.info
        self.stop()
        source = self._new_source()
        reception = Reception(
            self.name, self.clock, self.settings, source, info, self._decimation, self._buffer
        )
        try:
            source.start()
        except BaseException:
            source.close()
            raise
        self._source, self._reception = source, reception
        self._listen(reception.receive)

    def stop(self) -> None:
        """End the stream; harmless if there is none."""
        source, reception = self._source, self._reception
        self._source = self._reception = None
        if source is None or reception is None:
            return
        source.halt()
        self._hear_no_more()
        with suppress(DeviceError):  # the stream is over: what its last records say no longer matters
            reception.settle()
        source.close()

    def safe_stop(self) -> None:
        """Ask for the end of the stream: nothing of a sensor moves. Any thread, any number of times; never raises."""
        source, reception = self._source, self._reception
        if source is not None and reception is not None:
            reception.halted = True
            source.halt()

    def close(self) -> None:
        """End the stream and disconnect; harmless when not connected."""
        self.stop()
        self._info = None

    def examine(self) -> list[Remark]:
        """Say what there is to say about the set-up; listens to the stream for a second if it is not running."""
        with listened(self, self.clock, _LISTEN_S, streams=self.streams):
            reception, counted = self._reception, self.health().notes[0]
        assert reception is not None  # noqa: S101  it ran
        return [
            *stream(reception, counted, self.info, self.settings, self.rate_hz),
            *box(self.name, self.clock, self.info, self.settings, self.own),
        ]

    def _new_source(self) -> Source:
        if self.settings.client == "pynetft":
            return PynetftSource(self.name, self.clock, self.settings, self.info.rate_hz)
        return BoxSource(self.name, self.clock, self.settings, self.own)

    def _require_well(self, word: int) -> None:
        if codec.is_serious_word(word):
            raise DeviceError(
                self.name,
                f"reports an error: {codec.words(word)}",
                hint="see the status on its web page; switch it off and on if it stays, and check the sensor's cable",
            )
