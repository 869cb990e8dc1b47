"""A hinge from its free swings."""

from typing import TYPE_CHECKING, ClassVar

from pydantic import BaseModel

from labrun.fit.dataset import load_dataset
from labrun.fit.method import FitJob
from labrun.fit.methods.model import NoSettings

if TYPE_CHECKING:
    from labrun.fit.result import FitResult

STARTS = 2
"""A hinge fit starts from its own Fourier estimate."""


class HingeFit:
    """Stiffness and damping by Fourier derivatives and by simulation; the model says what is known of the body."""

    Settings: ClassVar[type[BaseModel]] = NoSettings

    def __init__(self, settings: NoSettings) -> None:  # noqa: ARG002  (has none)
        return

    def __call__(self, job: FitJob) -> "FitResult":
        """Fit; see `labrun.fit.hinge.fit_hinge`."""
        from labrun.fit.hinge import fit_hinge
        from labrun.fit.hinge_model import hinge_model

        hinge = hinge_model(job.model)
        names = {output.name for output in hinge.outputs}
        signals = {name: channel for name, channel in job.signals.items() if name in names}
        dataset = load_dataset(job.target, hinge, signals)
        return fit_hinge(dataset, job.model, rng=job.rng, starts=job.starts or STARTS, note=job.note)
