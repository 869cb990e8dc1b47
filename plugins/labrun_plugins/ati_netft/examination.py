"""What `labrun doctor --hardware` says about a box: rate, losses, units, status, and whether its two doors agree."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from labrun.devices import Remark
from labrun_plugins.ati_netft import codec, network, status, units
from labrun_plugins.ati_netft.datagrams import DatagramSocket

if TYPE_CHECKING:
    from labrun_plugins.ati_netft.driver import AtiNetFt

_LISTEN_S = 1.0
_LOOK_EVERY_S = 0.02
_RATE_TOLERANCE = 0.02
_ENOUGH_S = 0.3


def examine(device: "AtiNetFt") -> list[Remark]:
    """Listen for a second, and compare what the box says by HTTP and by TCP; DeviceError if the stream fails."""
    return [*_stream(device), _buffer(device), _units(device), *_tcp(device)]


def _stream(device: "AtiNetFt") -> Iterator[Remark]:
    own_start = device.reception is None
    if own_start:
        device.start()
    try:
        until_s = device.clock.now() + _LISTEN_S
        while device.clock.now() < until_s:
            device.clock.sleep(_LOOK_EVERY_S)
            device.read() if own_start else device.health()
        notes = device.health().notes
        reception = device.reception
    finally:
        if own_start:
            device.stop()
    assert reception is not None  # noqa: S101  it runs
    counts, measured, told = reception.sequencer.counts, reception.rate_hz(), device.info.rate_hz
    if abs(measured / told - 1.0) > _RATE_TOLERANCE:
        advice = (
            f"look at the RDT output rate on http://{device.settings.host}/comm.htm, and for another program"
        )
        yield Remark("warning", "rate", f"says {told:g} samples/s, sends {measured:.5g}", advice)
    else:
        yield Remark("ok", "rate", f"{measured:.5g} records/s; {device.rate_hz:g} samples/s are handed over")
    if counts.lost or counts.restarts:
        advice = (
            'a network port of its own for the box, without a switch shared with others; or mode = "buffered"'
        )
        yield Remark("warning", "losses", notes[0], advice)
    else:
        yield Remark("ok", "losses", notes[0])
    word = reception.last_status
    if word & status.CONDITION:
        advice = f"clear it on http://{device.settings.host}/moncon.htm, or switch monitor conditions off"
        yield Remark("warning", "status", status.words(word), advice)
    elif word:
        yield Remark("problem", "status", status.words(word), "unload the sensor; check its cable to the box")
    else:
        yield Remark("ok", "status", status.words(word))


def _buffer(device: "AtiNetFt") -> Remark:
    box = (device.settings.host, device.settings.rdt_port)
    socket = DatagramSocket(device.name, device.clock, device.own, box)
    holds_s = socket.capacity() / device.info.rate_hz
    socket.close()
    message = f"the system holds {holds_s:.2g} s of records while this program is busy"
    if holds_s < _ENOUGH_S:
        return Remark("warning", "buffer", message, "sudo sysctl -w net.core.rmem_max=4194304")
    return Remark("ok", "buffer", message)


def _units(device: "AtiNetFt") -> Remark:
    info = device.info
    said = (
        f"{info.counts_per_force:g} counts per {info.force_unit}, "
        f"{info.counts_per_torque:g} per {info.torque_unit}; range as of {device.settings.calibration}"
    )
    return Remark("ok", "units", said, "compare with the calibration certificate")


def _tcp(device: "AtiNetFt") -> Iterator[Remark]:
    where = f"TCP port {device.settings.tcp_port}"
    try:
        answer = network.ask_tcp(
            device.settings, device.own, codec.calibration_request(), codec.CALINFO_BYTES
        )
        reading = network.ask_tcp(device.settings, device.own, codec.read_ft_request(), codec.READFT_BYTES)
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
    info = device.info
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
