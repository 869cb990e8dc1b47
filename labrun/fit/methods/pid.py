"""Controllers for a fitted response."""

from typing import TYPE_CHECKING, ClassVar

from pydantic import BaseModel

from labrun.fit.method import FitJob
from labrun.fit.tuning.settings import PidSettings

if TYPE_CHECKING:
    from labrun.fit.summary import FitSummary


class PidDesign:
    """P, PI and PID, also with a feed-forward, by SIMC and by optimum under margins; predicted before they run."""

    Settings: ClassVar[type[BaseModel]] = PidSettings

    def __init__(self, settings: PidSettings) -> None:
        self._settings = settings

    def __call__(self, job: FitJob) -> "FitSummary":
        """Fit the response, then design; see `labrun.fit.tuning.result.design_controllers`."""
        from labrun.fit.tuning.result import design_controllers

        return design_controllers(job, self._settings)
