"""What an experiment file says about a slider of two positions."""

from typing import ClassVar

from pydantic import Field, NonNegativeInt, PositiveFloat, model_validator

from labrun_plugins.arduino_servo.settings import PULSE_US, BoardSettings

KIND = "labslider"
"""What the firmware says it is: `labservo` with another name and two switches."""
SWITCHES = 2
STILL_S = 0.1
"""A switch must stay closed for so long before it counts: it bounces."""


class TendonSliderSettings(BoardSettings):
    """Keys of a slider that a servo pulls by a tendon, against a spring.

    Attributes
    ----------
    condition
        The name in a condition that says which state a trial wants.
    states
        Names of both: first that in which the spring holds it, then that into which the tendon pulls it. Switch 0 of
        the firmware closes in the first, switch 1 in the second.
    state
        Wanted where the condition does not say; the first one unless given.
    released_us, pulled_us
        Pulse widths of the servo with the tendon slack, and tight. Either may be the greater one.
    move_s
        How long the servo takes from one to the other.
    arrive_s
        How long after that its switch may take to close, before it counts as stuck.
    channel
        Of the firmware.
    """

    example: ClassVar[str] = """\\
port   = "/dev/ttyACM1"
states = ["long", "short"]             # held by the spring, pulled by the tendon
state  = "long"                        # where no condition `beam` says otherwise"""

    condition: str = Field(default="beam", pattern=r"^[A-Za-z_]\\w*$")
    states: tuple[str, str] = ("long", "short")
    state: str | None = None
    released_us: int = Field(default=1000, ge=PULSE_US[0], le=PULSE_US[1])
    pulled_us: int = Field(default=2000, ge=PULSE_US[0], le=PULSE_US[1])
    move_s: PositiveFloat = Field(default=1.0, le=30.0)
    arrive_s: PositiveFloat = Field(default=2.0, le=60.0)
    channel: NonNegativeInt = Field(default=0, le=11)

    @model_validator(mode="after")
    def _states_differ(self) -> "TendonSliderSettings":
        if self.states[0] == self.states[1]:
            raise ValueError(f"states: both are called {self.states[0]!r}")
        if self.state is not None and self.state not in self.states:
            raise ValueError(f"state = {self.state!r} is not one of states {list(self.states)}")
        if abs(self.pulled_us - self.released_us) < 10:
            raise ValueError("released_us and pulled_us are less than 10 us apart: nothing would be pulled")
        return self

    @property
    def resting(self) -> str:
        """The state that is wanted where the condition does not say."""
        return self.state or self.states[0]

    def pulse_us(self, pulled: float) -> float:
        """Return the pulse width of a share of the tendon's way, 0 slack to 1 tight, us."""
        return self.released_us + (self.pulled_us - self.released_us) * pulled

    def pulled(self, pulse_us: float) -> float:
        """Return the share of the tendon's way of a pulse width."""
        return (pulse_us - self.released_us) / (self.pulled_us - self.released_us)

    def pulse_window_us(self) -> tuple[int, int]:
        """Return least and greatest pulse width, us: what the firmware is told."""
        return min(self.released_us, self.pulled_us), max(self.released_us, self.pulled_us)
