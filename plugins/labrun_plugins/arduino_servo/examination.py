"""What `labrun doctor --hardware` wants to know of the board."""

from labrun.devices import DeviceError, Remark
from labrun_plugins.arduino_servo.servo_board import ServoBoard
from labrun_plugins.arduino_servo.settings import BoardSettings
from labrun_plugins.labline.session import Hello, LineSession

_MAJOR = "1"
_FLASH = "flash firmware/labservo/labservo.ino of the plugin's folder"


def examine(name: str, board: ServoBoard, settings: BoardSettings) -> list[Remark]:
    """Return remarks on firmware, channels, rate and watchdog.

    Parameters
    ----------
    name
        The device's name.
    board
        Open.
    settings
        Of the board.
    """
    hello, session = board.hello, board.session
    remarks = [
        _firmware(name, hello),
        _channels(name, hello, board.channels_needed),
        _rate(name, hello, settings.rate_hz),
    ]
    if session.watchdog_ms == 0:  # nothing has moved yet: it can be tried
        remarks.append(_watchdog(name, session, settings.watchdog_ms))
    if session.counts.rejected:
        found = (
            f"{session.counts.rejected} of {session.counts.rejected + session.counts.accepted} lines damaged"
        )
        advice = "use a shorter or shielded USB cable, away from the servos' supply; connect the grounds"
        remarks.append(Remark("warning", name, found, advice))
    return remarks


def _firmware(name: str, hello: Hello) -> Remark:
    found = f"firmware {hello.kind} {hello.firmware}"
    if hello.firmware.split(".")[0] != _MAJOR:
        return Remark("problem", name, f"{found}; this driver knows {_MAJOR}.x", _FLASH)
    return Remark("ok", name, found)


def _channels(name: str, hello: Hello, needed: int) -> Remark:
    found = f"{hello.channels} channels, {needed} needed"
    if hello.channels < needed:
        return Remark("problem", name, found, f"add the pins to PINS and {_FLASH}")
    return Remark("ok", name, found)


def _rate(name: str, hello: Hello, rate_hz: float) -> Remark:
    found = f"takes {hello.max_rate_hz:g} set-points/s, {rate_hz:g} are sent"
    if hello.max_rate_hz < rate_hz:
        return Remark("problem", name, found, f"set rate_hz = {hello.max_rate_hz:g}")
    return Remark("ok", name, found)


def _watchdog(name: str, session: LineSession, watchdog_ms: int) -> Remark:
    try:
        session.arm(watchdog_ms)
        session.arm(0)
    except DeviceError as error:
        return Remark("problem", name, f"its watchdog cannot be armed: {str(error).splitlines()[0]}", _FLASH)
    return Remark("ok", name, f"watchdog takes {watchdog_ms} ms")
