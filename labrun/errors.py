"""The one tree of exceptions. Each message is for the person at the bench."""

from typing import Any


class LabrunError(Exception):
    """Something labrun can explain.

    Parameters
    ----------
    message
        What was found, where, and what was expected.
    hint
        What to do next; printed on a line of its own.
    """

    exit_code = 1

    def __init__(self, message: str, *, hint: str | None = None) -> None:
        super().__init__(message)
        self.hint = hint
        self.details: dict[str, Any] = {}
        """What a script may want beside the message: the run's folder, its trials, the problems of a file."""

    def __str__(self) -> str:
        message = super().__str__()
        return f"{message}\n  {self.hint}" if self.hint else message


class RequestError(LabrunError):
    """The request itself was wrong: nothing moved, nothing was written."""

    exit_code = 2


class SpecError(RequestError):
    """An experiment file, or an override of it, does not hold."""


class PluginError(RequestError):
    """A plugin is unknown, or fails to import."""


class ModelError(RequestError):
    """A model or an effect, or the way it is used, does not hold."""


class PlanError(RequestError):
    """The plan would leave a limit, or leaves nothing to run."""


class RecordingError(RequestError):
    """A recording or a stored run cannot be read as what it claims to be."""


class RigBusyError(RequestError):
    """Another run holds this rig or this run folder."""


class ExperimentError(LabrunError):
    """The experiment failed while it ran; what was saved stays."""


class DeviceError(ExperimentError):
    """A device did not do what it should.

    Parameters
    ----------
    device
        Its name in the experiment file.
    message
        What happened.
    hint
        The next thing to try.
    """

    def __init__(self, device: str, message: str, *, hint: str | None = None) -> None:
        super().__init__(f"device {device}: {message}", hint=hint)
        self.device = device
        self.clock_s: float | None = None
        """When it was seen, by the run's clock."""

    def happened(self, during: str, start_s: float) -> None:
        """Add the time of the error to its message, counted from the start of the current step."""
        if self.clock_s is not None:
            self.args = (f"{self.args[0]} {during}, {self.clock_s - start_s:.3f} s after its start",)


class LimitExceededError(DeviceError):
    """A sample or a command left its limit while the rig was moving."""


class SettleError(ExperimentError):
    """The bench did not come to rest in the time the file allows."""


class StoreError(ExperimentError):
    """Data could not be written safely."""


class FitError(LabrunError):
    """A model cannot be fitted to this data."""
