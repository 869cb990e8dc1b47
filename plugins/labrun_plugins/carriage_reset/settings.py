"""What an experiment file says about the servo and pulley that pull a carriage back."""

from typing import ClassVar

from pydantic import Field, NonNegativeInt, PositiveFloat, model_validator

from labrun_plugins.arduino_servo.settings import PULSE_US, BoardSettings

KIND = "labreset"
"""What the firmware says it is: `labservo` with another name, so that the board is not taken for that of the fins."""
_SLACK_M = 1e-9


class CarriageResetSettings(BoardSettings):
    """Keys of a winch: a servo that winds a line up on a pulley. Lengths are of the line, from the carriage's start.

    Attributes
    ----------
    stroke_m
        How much line there is between both ends: how far the carriage can get from its start.
    start_us, end_us
        Pulse widths at which the line is wound up (the carriage stands at its start), and paid out. Either may be the
        greater one.
    top_speed_m_s
        Greatest speed of the winch; measure it, a servo under load is slower.
    release
        Pay the line out again once the carriage has been pulled to its start, so that it swims freely.
    hold_s
        How long it is held at the start before that.
    channel
        Of the firmware.
    """

    example: ClassVar[str] = """\
port     = "/dev/ttyACM0"
stroke_m = 1.0                         # line between both ends
limits   = { travel_m = [0, 1], speed_m_s = 0.2 }"""

    stroke_m: PositiveFloat = 1.0
    start_us: int = Field(default=1000, ge=PULSE_US[0], le=PULSE_US[1])
    end_us: int = Field(default=2000, ge=PULSE_US[0], le=PULSE_US[1])
    top_speed_m_s: PositiveFloat = 0.3
    release: bool = True
    hold_s: float = Field(default=2.0, ge=1.0, le=60.0)
    channel: NonNegativeInt = Field(default=0, le=11)

    @model_validator(mode="after")
    def _ends_differ(self) -> "CarriageResetSettings":
        if abs(self.end_us - self.start_us) < 10:
            raise ValueError("start_us and end_us are less than 10 us apart: the line would not move")
        travel = self.limits.travel_m
        if travel is not None and not -_SLACK_M <= travel[0] < travel[1] <= self.stroke_m + _SLACK_M:
            raise ValueError(
                f"limits.travel_m = [{travel[0]:g}, {travel[1]:g}] reaches beyond the line, 0 ... {self.stroke_m:g} m"
            )
        return self

    @property
    def travel_m(self) -> tuple[float, float]:
        """Lengths of line that may be asked for, m."""
        return self.limits.travel_m or (0.0, self.stroke_m)

    @property
    def speed_m_s(self) -> float:
        """Greatest speed that may be asked for, m/s."""
        return min(self.top_speed_m_s, self.limits.speed_m_s or self.top_speed_m_s)

    def exact_pulse_us(self, line_m: float) -> float:
        """Return the pulse width of a length of line, us, before it is rounded to a whole one."""
        return self.start_us + (self.end_us - self.start_us) * line_m / self.stroke_m

    def line_m(self, pulse_us: float) -> float:
        """Return the length of line of a pulse width, m."""
        return (pulse_us - self.start_us) / (self.end_us - self.start_us) * self.stroke_m

    def pulse_window_us(self) -> tuple[int, int]:
        """Return least and greatest pulse width, us: what the firmware is told."""
        ends = sorted(round(self.exact_pulse_us(end_m)) for end_m in self.travel_m)
        return ends[0], ends[1]
