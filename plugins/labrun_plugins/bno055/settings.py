"""Keys of a BNO055 in the experiment file."""

from typing import ClassVar, Literal

from pydantic import Field, field_validator

from labrun.devices import DeviceSettings, Port

OFFSET_BYTES = 22


class Bno055Settings(DeviceSettings):
    """What a person may say about the IMU.

    Mode "imu" goes without the magnetometer, as is wise near motors: its heading drifts. "ndof" takes it in.

    Attributes
    ----------
    port
        Its serial port, for example ``/dev/ttyUSB1``.
    mounted_on
        The body it is fixed to.
    rate_hz
        Readings a second; the chip works out 100 orientations a second.
    mode
        Of its sensor fusion.
    baud
        Fixed in the chip.
    external_crystal
        Whether a 32 kHz crystal is fitted on the board: a steadier clock than the chip's own.
    offsets
        22 bytes of calibration in hexadecimal, as `labrun doctor --hardware` prints them for a calibrated chip; written
        at every connection, because the chip forgets them with its supply.
    jump_deg_s
        A turn between two readings that is faster than the gyroscope tells by more than this is taken for damaged
        bytes: the line has no checksum.
    """

    example: ClassVar[str] = """\
port       = "/dev/ttyUSB0"
mounted_on = "body"                    # what it is glued on"""

    port: Port
    mounted_on: str = Field(min_length=1)
    rate_hz: float = Field(default=100.0, gt=0, le=100.0)
    mode: Literal["imu", "ndof"] = "imu"
    baud: int = Field(default=115_200, ge=9_600, le=921_600)
    external_crystal: bool = False
    offsets: str | None = None
    jump_deg_s: float = Field(default=300.0, gt=0)

    @field_validator("offsets")
    @classmethod
    def _twenty_two_bytes(cls, text: str | None) -> str | None:
        if text is None:
            return None
        try:
            count = len(bytes.fromhex(text))
        except ValueError:
            raise ValueError(f"{text!r} is not hexadecimal; expected bytes such as 'FE FF 0C ...'") from None
        if count != OFFSET_BYTES:
            raise ValueError(f"expected {OFFSET_BYTES} bytes; these are {count}")
        return text

    @property
    def offset_bytes(self) -> bytes | None:
        """The calibration as it goes over the line."""
        return None if self.offsets is None else bytes.fromhex(self.offsets)
