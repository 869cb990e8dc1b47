"""Gain, lag and dead time from steps."""

from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat

from labrun.fit.method import FitJob
from labrun.fit.signal_table import SignalTable

if TYPE_CHECKING:
    from labrun.fit.summary import FitSummary


class ResponseTable(BaseModel):
    """One response: which trials, from what to what, and when.

    `input_unit` is for an input whose unit nothing states, as a named part of a gait.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    input: SignalTable
    output: SignalTable
    input_unit: str | None = None
    where: dict[str, float | str] = {}
    from_s: NonNegativeFloat = 0.0
    to_s: PositiveFloat | None = None


class FopdtSettings(BaseModel):
    """Keys of the fit: a response by each name."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    responses: dict[str, ResponseTable] = Field(min_length=1)


class FopdtFit:
    """Every response as ``gain exp(-dead_time s)/(lag s + 1)``, see `labrun.fit.transfer.fitting`."""

    Settings: ClassVar[type[BaseModel]] = FopdtSettings

    def __init__(self, settings: FopdtSettings) -> None:
        self._settings = settings

    def __call__(self, job: FitJob) -> "FitSummary":
        """Fit every response, each by itself."""
        from labrun.fit.transfer.fitting import fit_fopdt
        from labrun.fit.transfer.loading import load_response
        from labrun.fit.transfer.starts import STARTS
        from labrun.fit.transfer.summary import summarise

        fits: dict[str, Any] = {}
        for name, table in self._settings.responses.items():
            job.note(f"fitting {name}")
            loaded = load_response(
                job.target, table.input, table.output,
                where=table.where, from_s=table.from_s, to_s=table.to_s,
            )  # fmt: skip
            signals = loaded.signals
            fits[name] = fit_fopdt(
                loaded.trials,
                rng=job.rng,
                starts=job.starts or STARTS,
                input_name=table.input.channel,
                output_name=name,
                input_unit=table.input_unit or loaded.input_unit,
                output_unit=loaded.output_unit,
            )
        return summarise("fopdt", fits, signals)
