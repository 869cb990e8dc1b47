"""What is wrong on a bus, in words that name the joint and the next thing to try."""

from collections.abc import Collection, Mapping, Sequence

from labrun.devices import DeviceError
from labrun_plugins.dynamixel.codec import Status
from labrun_plugins.dynamixel.control_table import REFUSALS


class Complaints:
    """Makes the errors of one bus.

    Parameters
    ----------
    device
        The device's name.
    baud
        Bits a second.
    names
        Id -> joint.
    """

    def __init__(self, device: str, baud: int, names: Mapping[int, str]) -> None:
        self._device = device
        self._baud = baud
        self._names = names

    def who(self, ids: Sequence[int]) -> str:
        """Return the joints of these ids as a person calls them."""
        return ", ".join(f"joint {self._names.get(identity, '?')} (id {identity})" for identity in ids)

    def silent(self, ids: Sequence[int], *, damaged: bool, strangers: Collection[int]) -> DeviceError:
        """Return the error for servos that do not answer, or only with noise.

        Parameters
        ----------
        ids
            Of the servos.
        damaged
            Whether something came that was no answer.
        strangers
            Ids that answered without having been asked.
        """
        who = self.who(ids)
        if damaged:
            return DeviceError(
                self._device,
                f"answers of {who} arrive damaged: their check sums do not hold",
                hint="check the cable, its length and its shield; a lower baud (in servos and file) is sturdier",
            )
        others = ", ".join(str(identity) for identity in sorted(set(strangers) - set(self._names)))
        if others:
            return DeviceError(
                self._device,
                f"{who} does not answer, but id {others} does, which no joint of the file has",
                hint="compare joints.<joint>.id with the servos; two servos with one id disturb each other",
            )
        return DeviceError(
            self._device,
            f"{who} does not answer at {self._baud} bits/s",
            hint="check its power supply and plug; labrun doctor --hardware lists what answers, and at which baud",
        )

    def refused(self, status: Status, what: str) -> DeviceError:
        """Return the error for an answer that says no."""
        why = REFUSALS.get(status.refusal, f"answers with error {status.refusal}")
        return DeviceError(
            self._device,
            f"{self.who([status.id])} refuses {what}: it {why}",
            hint="another program may have changed its set-up; switch its power off and on, then try again",
        )
