"""Any model, by simulating it."""

from typing import TYPE_CHECKING, ClassVar

from pydantic import BaseModel

from labrun.errors import RequestError
from labrun.fit.dataset import load_dataset
from labrun.fit.method import FitJob, NoSettings

if TYPE_CHECKING:
    from labrun.fit.result import FitResult

STARTS = 5


class ModelFit:
    """Output error: the model is simulated, and its parameters are those whose outputs come nearest to the measured."""

    Settings: ClassVar[type[BaseModel]] = NoSettings

    def __init__(self, settings: NoSettings) -> None:  # noqa: ARG002  (has none)
        return

    def __call__(self, job: FitJob) -> "FitResult":
        """Fit `job.model`; see `labrun.fit.output_error.fit_model`."""
        from labrun.fit.output_error import fit_model

        if job.model is None:
            raise RequestError(
                f"no model named for {job.target}",
                hint="name one with --model FILE, or as [fit] model in the experiment, "
                "or put model.toml beside recording.toml",
            )
        dataset = load_dataset(job.target, job.model, job.signals)
        return fit_model(job.model, dataset, rng=job.rng, starts=job.starts or STARTS, note=job.note)
