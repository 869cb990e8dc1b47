"""Baskets of regressors by least squares, and which of them to take."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat

from labrun.fit.baskets.terms import BASKETS
from labrun.fit.method import FitJob
from labrun.fit.signal_table import SignalTable

if TYPE_CHECKING:
    from labrun.fit.summary import FitSummary


class LeastSquaresSettings(BaseModel):
    """Keys of ``[fit.settings]``.

    Attributes
    ----------
    inputs, outputs
        Signals by the names that terms and results have.
    baskets
        Lists of terms; those of Table 5.3 if none are given.
    units
        Of inputs whose unit is not recorded.
    intercept
        Whether each basket has a constant too.
    delay_s
        Regressors are taken from this long ago.
    average
        ``"cycle"``: each term is averaged over the last gait cycle, like cycle-averaged outputs are.
    rate_hz
        Of the time base.
    block_s
        Length of the blocks that are left out and resampled where there are fewer than three trials.
    largest_condition
        Of X'X: a basket above it is not taken.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    inputs: Annotated[dict[str, SignalTable], Field(min_length=1)]
    outputs: Annotated[dict[str, SignalTable], Field(min_length=1)]
    baskets: Annotated[dict[str, Annotated[list[str], Field(min_length=1)]], Field(min_length=1)] = BASKETS
    units: dict[str, str] = {}
    intercept: bool = False
    delay_s: NonNegativeFloat = 0.0
    average: Literal["none", "cycle"] = "cycle"
    rate_hz: PositiveFloat = 20.0
    block_s: PositiveFloat = 25.0
    largest_condition: PositiveFloat = 1e4


class LeastSquaresFit:
    """Eq. (5.4) for each basket; see `labrun.fit.baskets.fitting.fit_baskets`."""

    Settings: ClassVar[type[BaseModel]] = LeastSquaresSettings

    def __init__(self, settings: LeastSquaresSettings) -> None:
        self._settings = settings

    def __call__(self, job: FitJob) -> "FitSummary":
        """Fit every basket to every output."""
        from labrun.fit.baskets.fitting import fit_baskets

        return fit_baskets(job, self._settings)
