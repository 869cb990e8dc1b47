"""From what a trial wants to a slider that is seen to be there: what driver and stand-in have in common."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from labrun.devices import Clock, DeviceError, Trajectory
from labrun_plugins.tendon_slider.settings import STILL_S, TendonSliderSettings

SLIDER = "slider"
"""The bench's joint: 0 where the spring holds it, 1 where the tendon has pulled it."""


class Changeover:
    """What was asked for, and whether the switches say that it is so.

    Parameters
    ----------
    device
        The device's name, for messages.
    settings
        Of the slider.
    clock
        The run's clock.
    switches
        Returns which of the two switches are closed.
    stop
        Stops the servo.
    """

    def __init__(
        self,
        device: str,
        settings: TendonSliderSettings,
        clock: Clock,
        switches: Callable[[], Sequence[bool]],
        stop: Callable[[], None],
    ) -> None:
        self._device = device
        self._settings = settings
        self._clock = clock
        self._switches = switches
        self._stop = stop
        self.wanted: str | None = None
        """The state that was asked for last; None before the first trial."""
        self._due_s = 0.0
        self._seen_s: float | None = None
        self._verified = False

    def want(self, condition: Mapping[str, float | str]) -> bool:
        """Take a trial's condition; return whether the slider has to be moved for it.

        Raises DeviceError: a state that it does not have.
        """
        keys = self._settings
        wanted = condition.get(keys.condition, keys.resting)
        if wanted not in keys.states:
            raise DeviceError(
                self._device,
                f"{keys.condition} = {wanted!r} is not one of its states; nothing was moved",
                hint=f"its states are {keys.states[0]!r} and {keys.states[1]!r}",
            )
        moves = wanted != self.wanted
        self.wanted = str(wanted)
        self._verified, self._seen_s = False, None
        self._due_s = self._clock.now() + (keys.move_s if moves else 0.0) + keys.arrive_s
        return moves

    def path(self, from_pulled: float) -> Trajectory:
        """Return the tendon's way to the wanted state at even speed, from a share of it on."""
        to = float(self._settings.states.index(self.wanted or self._settings.resting))
        return Trajectory((SLIDER,), np.array([0.0, self._settings.move_s]), np.array([[from_pulled], [to]]))

    def arrived(self) -> bool:
        """Tell whether the switches have said for a while that it stands where it was asked to.

        Raises DeviceError: they do not within the time that it may take: the servo was stopped first.
        """
        if self.wanted is None or self._verified:
            return True
        closed, now_s = tuple(self._switches()), self._clock.now()
        if closed == self._expected():
            if self._seen_s is None:
                self._seen_s = now_s
            self._verified = now_s - self._seen_s >= STILL_S
            return self._verified
        self._seen_s = None
        if now_s > self._due_s:
            self._stop()
            wanted, self.wanted = self.wanted, None  # the next trial moves it again
            raise DeviceError(
                self._device,
                f"did not arrive: {self._settings.condition} = {wanted!r} was requested, and {self._says(closed)}; "
                "its servo was stopped, and no trial was begun",
                hint="look at tendon, spring and switches; free the slider, then labrun resume",
            )
        return False

    def complaint(self) -> str | None:
        """Return what is wrong with a state that was verified before; None if nothing is."""
        if not self._verified or self.wanted is None:
            return None
        closed = tuple(self._switches())
        if closed == self._expected():
            return None
        return f"its slider has left {self.wanted!r}: {self._says(closed)}"

    def withdraw(self) -> None:
        """Forget what was asked for: after a stop nobody knows where the slider is."""
        self.wanted, self._verified, self._seen_s = None, False, None

    def _expected(self) -> tuple[bool, bool]:
        tight = self.wanted == self._settings.states[1]
        return (not tight, tight)

    def _says(self, closed: tuple[bool, ...]) -> str:
        states = [name for name, is_closed in zip(self._settings.states, closed, strict=True) if is_closed]
        if len(states) == 2:
            return "both of its switches are closed"
        return f"its switches say {states[0]!r}" if states else "none of its switches is closed"
