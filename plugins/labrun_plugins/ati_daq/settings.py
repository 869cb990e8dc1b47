"""Keys of an ATI force/torque sensor on a data acquisition card in the experiment file."""

from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field

from labrun.devices import DeviceSettings, Port

GAUGES = 6


class AtiDaqSettings(DeviceSettings):
    """What a person may say about the sensor and the card.

    Attributes
    ----------
    calibration_file
        The ``.cal`` file that came with the sensor; it names the sensor's serial number.
    input
        Physical channels of the card, gauge 1 to 6 in this order, as NI-DAQmx spells them.
    rate_hz
        Samples a second of each channel.
    wiring
        How the gauges are connected; the sensor's own amplifier wants ``"differential"``.
    range_v
        Input range of the card, plus and minus.
    bias_v
        Taken off the six voltages before the matrix is applied. Zeros leave that to the runner's tare.
    reader
        What gives the voltages: ``"nidaqmx"``, or ``"socket"`` for a program of one's own that serves those of
        any other card (the README says how).
    server, server_port
        Address and port of that program.
    silence_ms
        No sample for this long is a fault, ms.
    """

    example: ClassVar[str] = """\
calibration_file = "sensor.cal"        # came with your sensor
input  = "Dev1/ai0:5"
limits = { force_n = 20, torque_n_m = 1 }"""

    calibration_file: Path = Path("sensor.cal")
    input: Port = "Dev1/ai0:5"
    rate_hz: float = Field(default=1000.0, gt=0, le=100_000)
    wiring: Literal["differential", "single-ended"] = "differential"
    range_v: float = Field(default=10.0, gt=0, le=10.0)
    bias_v: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    reader: Literal["nidaqmx", "socket"] = "nidaqmx"
    server: str = "127.0.0.1"
    server_port: int = Field(default=49_160, ge=1, le=65_535)
    silence_ms: float = Field(default=200.0, ge=20.0, le=5_000.0)
