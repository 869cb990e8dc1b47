"""How a run can end before its plan does, and how a trial can fail without ending the run."""

from types import TracebackType

from labrun.errors import DeviceError, LabrunError


class Interrupted(LabrunError):  # noqa: N818  being asked to stop is not an error
    """Ctrl-C or SIGTERM: actuators stopped, data kept, the run can be resumed."""

    exit_code = 130


class LimitReached(Exception):  # noqa: N818  a stop that was asked for is not an error
    """The number of trials asked for is done; the run can be resumed."""


class SilentDeviceError(DeviceError):
    """A device stopped answering."""


class NonsenseError(DeviceError):
    """A device answered something that cannot be a measurement."""


class blaming:  # noqa: N801  reads as a statement: with blaming(device)
    """Turn whatever a driver raises into a DeviceError that names the device; labrun's own errors pass.

    A class, and no generator: it surrounds every call of a driver, hundreds of times a trial.
    """

    __slots__ = ("_device",)

    def __init__(self, device: str) -> None:
        self._device = device

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, Exception) and not isinstance(error, LabrunError):
            raise DeviceError(
                self._device,
                f"its driver failed: {type(error).__name__}: {error}",
                hint="check its cable and power; if it stays, this is a fault of its driver",
            ) from error
