"""Keys of a Robotiq FT300 in the experiment file."""

from typing import ClassVar

from pydantic import Field

from labrun.devices import DeviceSettings, Port


class RobotiqFt300Settings(DeviceSettings):
    """What a person may say about the sensor; the defaults are those it is delivered with.

    Attributes
    ----------
    port
        Its serial port, for example ``/dev/ttyUSB0``.
    baud, slave_id
        As set in the sensor.
    stream
        True: its own stream of 100 samples/s. False: its registers are read `poll_hz` times a second, which also works
        over links that cannot carry the stream.
    poll_hz
        Readings a second with ``stream = false``; a reading takes 13 ms on the wire, so 60 is the most.
    silence_ms
        A stream without a good frame for this long is lost, ms; the vendor's driver uses 160.
    """

    example: ClassVar[str] = """\
port   = "/dev/ttyUSB0"
limits = { force_n = 300, torque_n_m = 30 }"""

    port: Port
    baud: int = Field(default=19_200, ge=9_600, le=921_600)
    slave_id: int = Field(default=9, ge=1, le=247)
    stream: bool = True
    poll_hz: float = Field(default=50.0, gt=0, le=60.0)
    silence_ms: float = Field(default=160.0, ge=160.0, le=5_000.0)
