"""What an experiment file may say about the arm."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field, FiniteFloat, field_validator

from labrun.devices import Channel, DeviceSettings, Port

TcpPort = Annotated[int, Field(ge=1, le=65535)]
Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]

REACH_M = (0.0, 0.8)
"""Travel where the file gives no limit; the arm reaches 0.85 m from its base axis."""


class Ur5Settings(DeviceSettings):
    """Keys of the arm; `limits` bound travel (m along the line) and speed of the carriage.

    Attributes
    ----------
    host
        Network address of the controller.
    interface
        Address of this computer from which to connect; without it, the one that routes to `host`.
    rtde_port, dashboard_port, script_port, primary_port
        The controller's services; only an emulator or a forwarded port has others.
    backend
        How the arm is spoken to; labrun's own client is the only one.
    rate_hz
        Rate of the position stream; without it, the most the controller gives (CB3 125 Hz, e-Series 500 Hz).
    origin_m
        Position zero of the carriage, in the arm's base frame; without it, where the tool stands at the first open.
    direction
        Of rising position, in the base frame; its length does not matter.
    orientation_rad
        Rotation vector that the tool keeps; without it, the one it has at the first open.
    off_line_m
        How far beside the line the tool may stand when a move begins.
    watchdog_ms
        The controller stops a move by itself when the computer has been silent for this long.
    watchdog_register
        Number of the integer input register that carries the sign of life; 0 to 23 are shared with fieldbuses.
    on_reduced_speed
        A speed slider below 100 % (or reduced speed scaling) falsifies the speed of a move: ``fault`` refuses and
        ends such moves, ``note`` only tells of it.
    tool_channels
        Streams tool pose, speeds and speed scaling beside the position.
    """

    example: ClassVar[str] = """\
host   = "192.168.1.2"
limits = { travel_m = [0.0, 0.5], speed_m_s = 0.1 }      # along its line, from where the tool stands"""

    host: Port
    interface: str | None = None
    rtde_port: TcpPort = 30004
    dashboard_port: TcpPort = 29999
    script_port: TcpPort = 30002
    primary_port: TcpPort = 30001
    backend: Literal["own"] = "own"
    rate_hz: Annotated[float, Field(gt=0, le=500)] | None = None
    origin_m: Vector | None = None
    direction: Vector = (1.0, 0.0, 0.0)
    orientation_rad: Vector | None = None
    off_line_m: Annotated[float, Field(gt=0, le=0.05)] = 0.003
    watchdog_ms: Annotated[float, Field(ge=20, le=5000)] = 100.0
    watchdog_register: Annotated[int, Field(ge=0, le=47)] = 24
    on_reduced_speed: Literal["fault", "note"] = "fault"
    tool_channels: bool = False

    @field_validator("direction")
    @classmethod
    def _has_length(cls, direction: Vector) -> Vector:
        if math.hypot(*direction) < 1e-6:
            raise ValueError("a direction of length zero leads nowhere; [1, 0, 0] is along x")
        return direction


TOOL_CHANNELS = (
    Channel("tool_x", "m"), Channel("tool_y", "m"), Channel("tool_z", "m"),
    Channel("tool_rx", "rad"), Channel("tool_ry", "rad"), Channel("tool_rz", "rad"),
    Channel("target_speed", "m/s"), Channel("actual_speed", "m/s"),
    Channel("speed_scaling", "1"), Channel("constant_speed", "1"),
)  # fmt: skip
"""What `tool_channels` adds: tool pose in the base frame, speeds along the line, and whether the sample is one of the
constant-speed part of a move (1 or 0)."""


def channels_of(settings: Ur5Settings) -> tuple[Channel, ...]:
    """Return the channels that these settings ask for."""
    position = (Channel("position", "m"),)
    return position + TOOL_CHANNELS if settings.tool_channels else position


ACCELERATION_M_S2 = 0.5
"""Of the ramps at either end of a move that does not say; a ramp is v^2 / 2a long."""
SPEED_SHARE = 0.005
"""A sample counts as one at constant speed while the target speed is this close to the speed asked for."""
