"""What `labrun doctor --hardware` learns about a BNO055 and its line."""

from collections.abc import Iterator

import numpy as np

from labrun.devices import DeviceError, Identity, Remark, SerialPort
from labrun.devices.clock import RealClock
from labrun_plugins.bno055 import codec
from labrun_plugins.bno055.chip import Chip, Refused, Silent
from labrun_plugins.bno055.orientation import angles, up_in_body
from labrun_plugins.bno055.sampling import Sampling
from labrun_plugins.bno055.settings import OFFSET_BYTES, Bno055Settings

_BAUD = 115_200
_RATE_SHARE = 0.95
_OVERRUN_SHARE = 0.2
_AGREES_RAD = float(np.radians(3.0))
_G_M_S2 = 9.80665
_KNOWN_IDS = bytes((0xA0, 0xFB, 0x32, 0x0F))


def identity(ids: bytes, settings: Bno055Settings | None, offsets: bytes) -> Identity:
    """Return what the run keeps about the chip."""
    details = {"ids": ids[:4].hex(" ").upper(), "boot_loader": f"{ids[6]:02X}"}
    if settings is not None:
        details |= {
            "mode": settings.mode,
            "mounted_on": settings.mounted_on,
            "units": "m/s^2, deg/s, deg, degC in the chip",
            "resolution": "quaternion 2^-14, gyroscope 1/16 deg/s",
            "angles": "from the quaternion: Rz(heading) Rx(roll) Ry(pitch)",
            "calibration_offsets": offsets.hex(" ").upper(),
            "calibration_restored": "yes" if settings.offsets else "no",
        }
    return Identity("Bosch BNO055", firmware=f"{ids[5]:02X}.{ids[4]:02X}", details=details)


def of_identity(ids: bytes) -> Remark:
    """Judge the four ids."""
    message = f"ids {ids[:4].hex(' ').upper()}, firmware {ids[5]:02X}.{ids[4]:02X}"
    if ids[:4] == _KNOWN_IDS:
        return Remark("ok", "identity", message)
    expected = _KNOWN_IDS.hex(" ").upper()
    return Remark(
        "warning",
        "identity",
        f"{message}; {expected} expected",
        "one of its sensors may be broken: self-test it",
    )


def of_readings(sampling: Sampling, chip: Chip, now_s: float) -> Iterator[Remark]:
    """Judge what came of the readings so far: their rate, how busy the chip was, whether its numbers agree."""
    due = sampling.readings + sampling.lost
    rate_hz = sampling.readings / max(now_s - sampling.began_s, 1e-9)
    message = f"{rate_hz:.4g} readings a second, {sampling.lost} of {due} lost"
    if sampling.readings < _RATE_SHARE * due:
        yield Remark(
            "warning",
            "rate",
            message,
            "set the adapter's latency timer to 1 ms, or choose a smaller rate_hz; the chip makes 100 a second",
        )
    else:
        yield Remark("ok", "rate", message)
    share = chip.overruns / max(chip.requests, 1)
    busy = f"{chip.overruns} of {chip.requests} requests met a bus over-run"
    if share > _OVERRUN_SHARE:
        yield Remark("warning", "over-runs", busy, "some are normal; so many cost readings: lower rate_hz")
    else:
        yield Remark("ok", "over-runs", busy)
    if sampling.last_block is not None:
        yield from of_numbers(sampling.last_block)


def of_numbers(block: codec.Block) -> Iterator[Remark]:
    """Judge whether quaternion, gravity and the chip's own angles tell the same orientation."""
    q = block.quaternion / np.linalg.norm(block.quaternion)
    gravity = float(np.linalg.norm(block.gravity_m_s2))
    message = f"gravity {gravity:.2f} m/s^2"
    if abs(gravity - _G_M_S2) > 0.5:
        yield Remark("warning", "gravity", f"{message}, 9.81 expected", "switch its supply off and on")
    else:
        off_rad = float(np.arccos(np.clip(block.gravity_m_s2 @ up_in_body(q) / gravity, -1.0, 1.0)))
        text = f"{message}, {np.degrees(off_rad):.1f} deg off the vertical of its quaternion"
        if off_rad > _AGREES_RAD:
            advice = "tip it by hand and watch tilt, roll and pitch: axes may be remapped in this chip"
            yield Remark("warning", "gravity", text, advice)
        else:
            yield Remark("ok", "gravity", text)
    heading, roll, pitch = angles(q)
    off = np.abs(np.angle(np.exp(1j * (block.euler_rad - np.array([heading, roll, pitch])))))
    own = ", ".join(f"{angle:.1f}" for angle in np.degrees(block.euler_rad))
    if off.max() > _AGREES_RAD:
        yield Remark(
            "ok",
            "angles",
            f"the chip's own heading, roll, pitch ({own} deg) have other conventions; labrun uses its quaternion",
        )
    else:
        yield Remark(
            "ok", "angles", f"the chip's own heading, roll, pitch ({own} deg) agree with its quaternion"
        )


def of_calibration(chip: Chip, settings: Bno055Settings) -> Iterator[Remark]:
    """Judge the calibration, and print it for the experiment file; stops the fusion for a moment."""
    try:
        state = chip.state()
        system, gyro, accelerometer, magnetometer = state.calibration
        levels = (
            f"system {system}, gyroscope {gyro}, accelerometer {accelerometer}, magnetometer {magnetometer}"
        )
        wanting = [gyro, accelerometer] if settings.mode == "imu" else [gyro, accelerometer, magnetometer]
        if min(wanting) < 3:
            yield Remark(
                "warning",
                "calibration",
                f"{levels} (3 is full)",
                "keep it still for a few seconds (gyroscope), lay it on six sides (accelerometer), "
                "and swing it in figures of eight (magnetometer)",
            )
            return
        offsets = chip.read_offsets(settings)
    except Refused as refused:
        yield Remark("problem", "calibration", f"{refused}", "switch its supply off and on, then try again")
        return
    text = offsets.hex(" ").upper()
    same = settings.offset_bytes == offsets
    advice = "" if same else f'to keep it, in the device\'s table: offsets = "{text}"'
    yield Remark("ok", "calibration", levels, advice)


def probe(port: str) -> Identity | None:
    """Ask what is at a port for its chip ids."""
    clock = RealClock()
    line = SerialPort("probe", port, _BAUD)
    try:
        line.open()
        chip = Chip("probe", line, clock, answer_s=0.12)
        try:
            ids = chip.read(codec.IDS, 7)
        except Silent:
            return None
        except (
            Refused
        ):  # it may have taken the request for the rest of one that a program before left unfinished
            ids = chip.read(codec.IDS, 7)
        return identity(ids, None, bytes(OFFSET_BYTES)) if ids[0] == codec.CHIP_ID else None
    except (DeviceError, Refused):
        return None
    finally:
        line.close()
