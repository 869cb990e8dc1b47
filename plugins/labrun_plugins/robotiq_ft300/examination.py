"""What `labrun doctor --hardware` learns about an FT300 and its line."""

from collections.abc import Iterator
from pathlib import Path

from labrun.devices import DeviceError, Identity, Remark, SerialPort
from labrun.devices.clock import RealClock
from labrun_plugins.robotiq_ft300 import codec
from labrun_plugins.robotiq_ft300.link import Link, Nameplate
from labrun_plugins.robotiq_ft300.reception import Polling, Reception
from labrun_plugins.robotiq_ft300.settings import RobotiqFt300Settings

_RATE_TOLERANCE = 0.03
_LUMP = 1.3
"""Frames handed over at once, on average: 1 without a latency timer, 1.6 with one of 16 ms."""
_CRC_ERROR_SHARE = 1e-3


def identity(plate: Nameplate, mode: str, *, was_streaming: bool) -> Identity:
    """Return what the run keeps about the sensor."""
    return Identity(
        model=f"Robotiq FT300 ({plate.firmware.partition('-')[0]})",
        serial=plate.serial,
        firmware=plate.firmware,
        details={
            "production_year": str(plate.year),
            "mode": mode,
            "resolution": "0.01 N, 0.001 N m",
            "full_scale": "300 N, 30 N m",
            "zero_offset": "none taken off",
            "was_still_streaming": "yes" if was_streaming else "no",
        },
    )


def of_stream(source: Reception, port: str) -> Iterator[Remark]:
    """Judge what came of the stream so far: its rate, its lumps, its checksums."""
    frames = source.parser.frames
    rate_hz = source.rate_hz()
    message = f"stream of {rate_hz:.4g} Hz ({frames} frames in {source.lumps} portions)"
    timer = f"/sys/bus/usb-serial/devices/{Path(port).name}/latency_timer"
    shorter = f"echo 1 | sudo tee {timer} (a udev rule keeps it)"
    lumpy = source.lumps > 0 and frames > _LUMP * source.lumps
    if frames < 2:
        yield Remark("problem", "rate", "no stream came", "switch its supply off and on, then try again")
    elif abs(rate_hz / codec.STREAM_HZ - 1.0) > _RATE_TOLERANCE:
        yield Remark(
            "problem",
            "rate",
            f"{message}, {codec.STREAM_HZ:g} Hz expected",
            f"62.5 Hz means a latency timer of 16 ms: {shorter}",
        )
    elif lumpy:
        yield Remark(
            "warning", "rate", f"{message}: frames come in lumps, as with a latency timer of 16 ms", shorter
        )
    else:
        yield Remark("ok", "rate", message)
    wrong = source.parser.crc_errors
    if wrong > _CRC_ERROR_SHARE * frames:
        yield Remark(
            "warning",
            "checksums",
            f"{wrong} of {frames + wrong} frames had a wrong one",
            "check ground, shield and termination of the RS-485 cable, and keep it away from motor cables",
        )
    else:
        yield Remark("ok", "checksums", f"{wrong} wrong ones in {frames} frames")


def of_polling(source: Polling) -> Iterator[Remark]:
    """Judge what came of reading the registers so far."""
    message = f"{source.readings} readings of the registers, {source.lost} missed"
    if source.lost > 0.02 * source.readings:
        yield Remark("warning", "rate", message, "choose a smaller poll_hz, or stream = true for 100 Hz")
    else:
        yield Remark("ok", "rate", f"{message}; stream = true gives 100 Hz")


def of_nameplate(plate: Nameplate, jams: int) -> Iterator[Remark]:
    """Tell what it is, and whether it was left streaming."""
    yield Remark("ok", "identity", f"firmware {plate.firmware}, serial {plate.serial}, made in {plate.year}")
    if jams:
        yield Remark(
            "warning",
            "left streaming",
            f"it was still streaming when labrun came; {jams} jam(s) stopped it",
            "harmless; a program before did not end its stream (killed, or unplugged)",
        )


def probe(port: str) -> Identity | None:
    """Ask what is at a port whether it is an FT300 with the settings of delivery; None if it is not.

    Raises
    ------
    DeviceError
        pymodbus is not installed: nobody can be asked.
    """
    clock = RealClock()
    settings = RobotiqFt300Settings(port=port)
    line = SerialPort(port, port, settings.baud)
    link = Link(port, line, clock, settings.slave_id, answer_s=0.12, tries=1)
    try:
        line.open()
        streaming = link.streams()
        if streaming is None:
            return None
        if streaming:
            link.jam()
        return identity(link.nameplate(), "not chosen", was_streaming=streaming)
    except DeviceError:
        return None
    finally:
        line.close()
