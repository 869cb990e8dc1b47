"""What an experiment file says about the person at the bench."""

from typing import ClassVar

from pydantic import Field

from labrun.devices import DeviceSettings


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
