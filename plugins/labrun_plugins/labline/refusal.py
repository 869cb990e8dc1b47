"""What a board says when it does not do as it is told, in words for the person at the bench."""

from labrun.devices import DeviceError

_CODES = {
    "WORD": ("does not know {word}", "flash the firmware that stands in the plugin's folder"),
    "ARGC": ("expects another number of values", "flash the firmware that stands in the plugin's folder"),
    "RANGE": (
        "a value is outside the limits it was given{where}; nothing of it was carried out",
        "keep the motion inside the device's limits in the experiment file",
    ),
    "STATE": ("this cannot be done in its present state{where}", "reset the board, then labrun resume"),
    "WDOG": (
        "its watchdog has expired, so it stopped by itself and refuses to move",
        "the computer or the line stalled: close other programs, look at the cable, or raise watchdog_ms; "
        "then labrun resume",
    ),
    "LIMIT": (
        "a limit switch or a force limit stopped it{where}",
        "look at the bench, bring it back inside its limits, then labrun resume",
    ),
    "HW": (
        "its hardware is at fault{where}",
        "look for a blocked mechanism, a loose wire or a weak supply; reset the board, then labrun resume",
    ),
}
_OTHER = ("it refuses{where}", "see the README of the plugin; labrun resume goes on once it is mended")


class LineRefusedError(DeviceError):
    """A board answered ``ERR``, or said by itself that it stopped.

    Parameters
    ----------
    device
        Its name in the experiment file.
    word
        What it was asked.
    code, detail
        The error code (WORD, ARGC, RANGE, STATE, WDOG, LIMIT, HW), and what stands after it.
    """

    def __init__(self, device: str, word: str, code: str, detail: str = "") -> None:
        why, hint = _CODES.get(code, _OTHER)
        told = why.format(word=word, where=f" ({detail})" if detail else "")
        answer = f"ERR,{code}" + (f",{detail}" if detail else "")
        super().__init__(device, f"{told} (answer {answer} to {word})", hint=hint)
        self.word = word
        self.code = code
        self.detail = detail


class StoppedError(DeviceError):
    """A motion was not sent, because a stop came first."""
