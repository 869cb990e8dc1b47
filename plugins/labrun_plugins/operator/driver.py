"""The person who places a body by hand and lets it go."""

import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from labrun.devices import (
    Clock,
    DeviceContext,
    DeviceError,
    DeviceSettings,
    Health,
    Identity,
    NoTerminalError,
    Terminal,
    Trajectory,
    opened,
)
from labrun.errors import LimitExceededError


class OperatorSettings(DeviceSettings):
    """Keys of the operator.

    Attributes
    ----------
    instruction
        What the person is told; {angle_deg}, {joint} and what the trial varies ({area_cm2}) are filled in.
    patience_s
        How long to wait for the person's answer.
    """

    example: ClassVar[str] = """\
instruction = "Hold {joint} at {angle_deg} deg"  # a person is the actuator
limits = { angle_deg = [-90, 90] }"""

    instruction: str = "Hold {joint} at {angle_deg} deg"
    patience_s: float = Field(default=600.0, gt=0)


_LOOK_S = 0.002


class Operator:
    """Asks a person to take a body to an angle, and gives a tone when it is to be let go.

    A motion that goes somewhere is told as an instruction; it has arrived when the person presses Enter. A motion that
    stays at one angle throughout is a release: the terminal's bell rings when it starts.

    Parameters
    ----------
    name
        Its name in the experiment file, which is that of its joint.
    terminal
        Where the person sits; this process's own unless given.
    """

    Settings: ClassVar[type[DeviceSettings]] = OperatorSettings

    def __init__(
        self, name: str, settings: OperatorSettings, context: DeviceContext, terminal: Terminal | None = None
    ) -> None:
        self.name = name
        self.joints = (name,)
        self._settings = settings
        self._clock: Clock = context.clock
        self._terminal = terminal or Terminal()
        self._open = False
        self._asked_s: float | None = None
        self._stopped = threading.Event()
        self._angle_rad = 0.0
        self._condition: dict[str, str] = {}
        self._failure: NoTerminalError | None = None

    def open(self) -> None:
        """See that there is a terminal. Raises DeviceError: there is none: nobody could be asked."""
        try:
            self._terminal.require()
        except NoTerminalError as error:
            raise DeviceError(
                self.name,
                f"needs a person at a terminal, and {error}",
                hint="run labrun in a terminal, without redirecting its input; --dry-run and --emulate need nobody",
            ) from error
        self._open = True
        self._failure = None
        self._angle_rad = 0.0

    def identify(self) -> Identity:
        """Say that it is a person, and what the person is told."""
        self._require_open()
        return Identity("a person at the terminal", details={"instruction": self._settings.instruction})

    def health(self) -> Health:
        """Report whether somebody can still be asked."""
        if not self._open:
            return Health(ok=False, notes=("not connected",))
        if self._failure is not None:
            return Health(ok=False, notes=(f"the terminal is gone: {self._failure}",))
        return Health()

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Take what the coming trial varies, so that the person can be told what to put in place."""
        self._condition = {
            name: value if isinstance(value, str) else f"{value:.6g}" for name, value in condition.items()
        }

    def pose(self) -> Mapping[str, float]:
        """Return the angle the body was asked to be held at, rad; 0, where it hangs, once it was let go."""
        self._require_open()
        return {self.name: self._angle_rad}

    def follow(self, trajectory: Trajectory, start_s: float) -> None:
        """Ask for the motion's last angle, or, for a motion that stays at one angle, ring at `start_s`.

        Returns at once; `arrived` tells when the person has done it.

        Raises
        ------
        LimitExceededError
            The motion leaves a limit of the file: the person is not asked.
        DeviceError
            Another joint's motion, or nobody to ask.
        """
        self._require_open()
        if trajectory.joints != self.joints:
            raise DeviceError(
                self.name,
                f"got a motion of {', '.join(trajectory.joints)}, but holds {self.name}",
                hint="name the device after its joint",
            )
        for excess in self._settings.limits.trajectory_excess(trajectory):
            raise LimitExceededError(
                self.name, f"{excess}; the person was not asked", hint="change the condition"
            )
        self._stopped = threading.Event()  # its own for each request: one that was stopped stays so
        if trajectory.duration_s > 0 and np.ptp(trajectory.angle_rad[:, 0]) == 0.0:
            self._release(start_s)
        else:
            self._ask(float(trajectory.angle_rad[-1, 0]))

    def arrived(self) -> bool:
        """Tell whether the person has done what was asked; does not wait.

        Raises DeviceError: stopped meanwhile, nobody answers, or the terminal is gone.
        """
        if self._asked_s is None:
            return True
        if self._stopped.is_set():
            self._asked_s = None
            raise DeviceError(
                self.name, "was stopped while the person was asked", hint="labrun resume asks again"
            )
        try:
            done = self._terminal.answered()
        except NoTerminalError as error:
            raise self._gone(error) from error
        if done:
            self._asked_s = None
        elif self._clock.now() - self._asked_s > self._settings.patience_s:
            self._asked_s = None
            raise DeviceError(
                self.name,
                f"nobody pressed Enter for {self._settings.patience_s:g} s",
                hint="labrun resume asks again; patience_s says how long to wait",
            )
        return done

    def safe_stop(self) -> None:
        """Withdraw what was asked, and keep the bell from ringing; a body that swings comes to rest by itself."""
        self._stopped.set()

    def close(self) -> None:
        """Ask nothing any more; harmless when closed."""
        self._stopped.set()
        self._asked_s = None
        self._open = False

    @classmethod
    def emergency_stop(cls, name: str, settings: Any) -> None:
        """Nothing to stop: a body held by hand is where the hand is."""

    def _ask(self, angle_rad: float) -> None:
        angle = f"{np.degrees(angle_rad):.4g}"
        # Filled in by hand: a text from a file is no format for values of the program.
        instruction = self._settings.instruction
        for name, value in {**self._condition, "joint": self.name, "angle_deg": angle}.items():
            instruction = instruction.replace(f"{{{name}}}", value)
        condition = ", ".join(f"{name} = {value}" for name, value in self._condition.items())
        lines = [instruction, *([f"Trial: {condition}"] if condition else [])]
        lines.append(f"Press Enter when {self.name} is at {angle} deg.")
        try:
            self._terminal.ask("\n".join(lines))
        except NoTerminalError as error:
            raise self._gone(error) from error
        self._asked_s = self._clock.now()
        self._angle_rad = angle_rad

    def _release(self, start_s: float) -> None:
        threading.Thread(
            target=self._ring, args=(start_s, self._stopped), daemon=True, name=f"bell of {self.name}"
        ).start()
        self._angle_rad = 0.0

    def _ring(self, start_s: float, stopped: threading.Event) -> None:
        while (left_s := start_s - self._clock.now()) > 0:
            if stopped.is_set():
                return
            self._clock.sleep(min(left_s, _LOOK_S))
        if not stopped.is_set():
            with suppress(NoTerminalError):  # told when the person is asked the next time
                self._terminal.tone("Let go!")

    def _gone(self, error: NoTerminalError) -> DeviceError:
        self._failure = error
        self._asked_s = None
        return DeviceError(
            self.name, f"the person cannot be asked any more: {error}", hint="labrun resume, in a terminal"
        )

    def _require_open(self) -> None:
        opened(self.name, self._open)
