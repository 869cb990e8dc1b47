"""What an experiment file says about the motion capture."""

from ipaddress import IPv4Address
from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from labrun.devices import DeviceSettings, EulerAngles, HingeAngle, Port, unknown_bodies
from labrun.toml import Keys

MOST_SILENT_S = 0.5
"""The runner takes a sensor without samples for lost after this long, without knowing why."""

Bitstream = Annotated[str, Field(pattern=r"^\d{1,2}\.\d{1,2}$")]


class Angle(Keys):
    """A joint angle taken from a body's orientation: its turn about `axis` (fixed in the room)."""

    body: str
    axis: tuple[float, float, float]

    @model_validator(mode="after")
    def _has_direction(self) -> "Angle":
        if not any(self.axis):
            raise ValueError("expected a direction; [0, 0, 0] has none")
        return self


class OptiTrackSettings(DeviceSettings):
    """Keys of the motion capture.

    Attributes
    ----------
    host
        Address of the computer that runs Motive.
    interface
        Address (or, on Linux, name) of this computer's network interface to it; the one that routes to `host` unless
        given.
    command_port
        Motive's command port.
    data_port, group
        Where multicast frames arrive; as the server says unless given.
    transmission
        How frames come: as the server says, or as the file insists.
    bitstream
        Layout of the frames asked for, such as "4.1" (NatNet 4 and later, unicast); the server's own unless given.
    rate_hz
        Camera rate; must be what Motive says.
    bodies
        Rigid bodies by their names in Motive.
    angles
        Joint angles taken from the bodies' orientations.
    joints
        Joint angles taken from the orientations of two bodies; ``from`` left out is the room.
    euler
        Euler angles of bodies, in the room or against another body.
    markers
        Body -> how many of its labelled markers are stored besides its pose.
    up_axis
        Motive's streaming setting. NatNet does not tell it, so it is stored as the file states it.
    lost_tracking_s
        A body that is not tracked for longer than this fails the trial.
    """

    example: ClassVar[str] = """\
host    = "192.168.1.10"               # the machine that runs Motive
rate_hz = 120
bodies  = ["arm"]                      # rigid bodies as Motive calls them
angles  = { angle = { body = "arm", axis = [0, 1, 0] } }"""

    host: Port
    interface: str = ""
    command_port: int = Field(default=1510, ge=1, le=65535)
    data_port: int | None = Field(default=None, ge=1, le=65535)
    group: str | None = None
    transmission: Literal["auto", "unicast", "multicast"] = "auto"
    bitstream: Bitstream | None = None
    rate_hz: float = Field(default=360.0, gt=0, le=1000.0)
    bodies: tuple[str, ...] = Field(default=("arm",), min_length=1)
    angles: dict[str, Angle] = Field(default_factory=dict)
    joints: dict[str, HingeAngle] = Field(default_factory=dict)
    euler: dict[str, EulerAngles] = Field(default_factory=dict)
    markers: dict[str, Annotated[int, Field(ge=1, le=20)]] = Field(default_factory=dict)
    up_axis: Literal["x", "y", "z"] | None = None
    lost_tracking_s: float = Field(default=0.25, gt=0, le=MOST_SILENT_S)

    @field_validator("group")
    @classmethod
    def _is_multicast(cls, group: str | None) -> str | None:
        if group is not None and not IPv4Address(group).is_multicast:
            raise ValueError(f"{group} is not a multicast group; expected 224.0.0.0 ... 239.255.255.255")
        return group

    @model_validator(mode="after")
    def _bodies_are_known(self) -> "OptiTrackSettings":
        if len(set(self.bodies)) < len(self.bodies):
            raise ValueError(f"bodies {list(self.bodies)} names one of them twice")
        for name, angle in self.angles.items():
            if angle.body not in self.bodies:
                raise ValueError(
                    f"angle {name} is of body {angle.body!r}, which is not among bodies {list(self.bodies)}"
                )
        for fault in unknown_bodies(self.bodies, self.joints, self.euler):
            raise ValueError(fault)
        for body in self.markers:
            if body not in self.bodies:
                raise ValueError(
                    f"markers names body {body!r}, which is not among bodies {list(self.bodies)}"
                )
        return self
