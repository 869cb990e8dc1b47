"""What `labrun doctor --hardware` says about a box: rate, losses, units, status, and whether its two doors agree."""

from collections.abc import Iterator

from labrun.devices import Clock, Remark
from labrun_plugins.ati_netft import codec, network, status, units
from labrun_plugins.ati_netft.box_info import BoxInfo
from labrun_plugins.ati_netft.datagrams import DatagramSocket
from labrun_plugins.ati_netft.reception import Reception
from labrun_plugins.ati_netft.settings import AtiNetFtSettings

_RATE_TOLERANCE = 0.02
_ENOUGH_S = 0.3


def stream(
    reception: Reception, counted: str, info: BoxInfo, settings: AtiNetFtSettings, rate_hz: float
) -> Iterator[Remark]:
    """Judge what has been heard for a while.

    Parameters
    ----------
    counted
        What is said about the records.
    rate_hz
        Of the samples that are handed over.
    """
    counts, measured, told = reception.sequencer.counts, reception.rate_hz(), info.rate_hz
    if abs(measured / told - 1.0) > _RATE_TOLERANCE:
        advice = f"look at the RDT output rate on http://{settings.host}/comm.htm, and for another program"
        yield Remark("warning", "rate", f"says {told:g} samples/s, sends {measured:.5g}", advice)
    else:
        yield Remark("ok", "rate", f"{measured:.5g} records/s; {rate_hz:g} samples/s are handed over")
    if counts.lost or counts.restarts:
        advice = (
            'a network port of its own for the box, without a switch shared with others; or mode = "buffered"'
        )
        yield Remark("warning", "losses", counted, advice)
    else:
        yield Remark("ok", "losses", counted)
    word = reception.last_status
    if word & status.CONDITION:
        advice = f"clear it on http://{settings.host}/moncon.htm, or switch monitor conditions off"
        yield Remark("warning", "status", status.words(word), advice)
    elif word:
        yield Remark("problem", "status", status.words(word), "unload the sensor; check its cable to the box")
    else:
        yield Remark("ok", "status", status.words(word))


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
    if holds_s < _ENOUGH_S:
        return Remark("warning", "buffer", message, "sudo sysctl -w net.core.rmem_max=4194304")
    return Remark("ok", "buffer", message)


def _units(info: BoxInfo, settings: AtiNetFtSettings) -> Remark:
    said = (
        f"{info.counts_per_force:g} counts per {info.force_unit}, "
        f"{info.counts_per_torque:g} per {info.torque_unit}; range as of {settings.calibration}"
    )
    return Remark("ok", "units", said, "compare with the calibration certificate")


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
    said = f"{calibration.counts_per_force} counts per {force or 'unknown unit'}, "
    said += f"{calibration.counts_per_torque} per {torque or 'unknown unit'}; {status.words(decoded.status)}"
    if agrees:
        yield Remark("ok", where, said)
    else:
        advice = (
            "its web page and its TCP port disagree about units: choose the calibration again and restart it"
        )
        yield Remark("problem", where, said, advice)
