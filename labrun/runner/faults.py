"""How a run can end before its plan does, and how a trial can fail without ending the run."""

from collections.abc import Iterator
from contextlib import contextmanager

from labrun.errors import DeviceError, LabrunError


class Interrupted(LabrunError):  # noqa: N818  being asked to stop is not an error
    """Ctrl-C or SIGTERM: actuators stopped, data kept, the run can be resumed."""


class LimitReached(Exception):  # noqa: N818  a stop that was asked for is not an error
    """The number of trials asked for is done; the run can be resumed."""


class SilentDeviceError(DeviceError):
    """A device stopped answering."""


class NonsenseError(DeviceError):
    """A device answered something that cannot be a measurement."""


@contextmanager
def blaming(device: str) -> Iterator[None]:
    """Turn whatever a driver raises into a DeviceError that names the device; labrun's own errors pass."""
    try:
        yield
    except LabrunError:
        raise
    except Exception as error:
        raise DeviceError(
            device,
            f"its driver failed: {type(error).__name__}: {error}",
            hint="check its cable and power; if it stays, this is a fault of its driver",
        ) from error
