"""Keys of an ATI force/torque sensor on a Net F/T box in the experiment file."""

from typing import ClassVar, Literal

from pydantic import Field

from labrun.devices import DeviceSettings, Port

BOX_RATE_HZ = 7000.0
"""Samples the box itself takes in a second; every output rate is this divided by a whole number."""

Calibration = Literal["SI-20-1", "SI-40-2", "SI-80-4"]
RANGES: dict[Calibration, tuple[float, float, float]] = {
    "SI-20-1": (20.0, 60.0, 1.0),
    "SI-40-2": (40.0, 120.0, 2.0),
    "SI-80-4": (80.0, 240.0, 4.0),
}
"""Sensing range of a Mini40 by calibration: force x and y (N), force z (N), torque (N m)."""


def full_scale(calibration: Calibration) -> tuple[float, float, float, float, float, float]:
    """Return the end of the range of force x, y, z (N) and torque x, y, z (N m)."""
    force, axial, torque = RANGES[calibration]
    return force, force, axial, torque, torque, torque


class AtiNetFtSettings(DeviceSettings):
    """What a person may say about the box; the defaults are those it is delivered with.

    Attributes
    ----------
    host
        Its address, for example ``192.168.1.1``.
    rate_hz
        Samples a second that are wanted. The nearest 7000/n is what comes.
    set_rate
        True: the box is told to send at that rate, and keeps doing so afterwards. False: its set-up is left alone, and
        every n-th of its samples is handed over.
    calibration
        Of the sensor: says where its range ends. The certificate names it.
    mode
        ``"stream"``: each sample in a datagram of its own, at once. ``"buffered"``: as many together as the box is set
        to, which spares the network and comes that much later.
    client
        ``"labrun"``, or the library ``"pynetft"`` (see the README for what it cannot do).
    interface
        Network interface (``"eth1"``) or own address to use; by default the one that leads to `host`.
    silence_ms
        No datagram for this long is a fault, ms.
    rdt_port, http_port, tcp_port
        Ports of the box.
    """

    example: ClassVar[str] = """\
host    = "192.168.1.1"
rate_hz = 500
limits  = { force_n = 20, torque_n_m = 1 }"""

    host: Port
    rate_hz: float = Field(default=500.0, gt=0, le=BOX_RATE_HZ)
    set_rate: bool = False
    calibration: Calibration = "SI-20-1"
    mode: Literal["stream", "buffered"] = "stream"
    client: Literal["labrun", "pynetft"] = "labrun"
    interface: str | None = Field(default=None, min_length=1)
    silence_ms: float = Field(default=50.0, ge=20.0, le=5_000.0)
    rdt_port: int = Field(default=49_152, ge=1, le=65_535)
    http_port: int = Field(default=80, ge=1, le=65_535)
    tcp_port: int = Field(default=49_151, ge=1, le=65_535)
