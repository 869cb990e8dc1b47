"""The fits ``fopdt`` (gain, lag and dead time from steps) and ``transfer-function`` (given order)."""

from typing import ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat, model_validator

from labrun.errors import RequestError
from labrun.fit.method import FitJob
from labrun.fit.signals import SignalSet, SignalTable
from labrun.fit.transfer.estimation import Initial, Shape
from labrun.fit.transfer.fitting import STARTS, TransferFit, compare_orders, fit_transfer
from labrun.fit.transfer.summary import TransferSummary, summarise
from labrun.fit.transfer.trials import load_response


class _Keys(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ResponseTable(_Keys):
    """One response: which trials, from what to what, and when.

    `input_unit` is for an input whose unit nothing states, as a named part of a gait.
    """

    input: SignalTable
    output: SignalTable
    input_unit: str | None = None
    where: dict[str, float | str] = {}
    from_s: NonNegativeFloat = 0.0
    to_s: PositiveFloat | None = None


class FopdtSettings(_Keys):
    """Keys of the fit: a response by each name."""

    responses: dict[str, ResponseTable] = Field(min_length=1)


class FopdtFit:
    """Every response as ``gain exp(-dead_time s)/(lag s + 1)``, each by itself."""

    Settings: ClassVar[type[BaseModel]] = FopdtSettings

    def __init__(self, settings: FopdtSettings) -> None:
        self._responses = settings.responses

    def __call__(self, job: FitJob) -> TransferSummary:
        """Fit every response."""
        fits, signals = _fitted(job, self._responses, Shape(1, 0))
        return summarise("fopdt", fits, signals)


class TransferFunctionSettings(_Keys):
    """Keys of the fit: order, dead time, and either `input` and `output` or `responses`, as fopdt has them."""

    poles: int = Field(default=2, ge=1, le=8)
    zeros: int = Field(default=0, ge=0)
    dead_time: bool = False
    initial: Initial = "free"
    compare: bool = True
    input: SignalTable | None = None
    input_unit: str | None = None
    output: SignalTable | None = None
    where: dict[str, float | str] = {}
    from_s: NonNegativeFloat = 0.0
    to_s: PositiveFloat | None = None
    responses: dict[str, ResponseTable] = {}

    @model_validator(mode="after")
    def _proper(self) -> Self:
        if self.zeros > self.poles:
            raise ValueError(f"zeros = {self.zeros} must not be more than poles = {self.poles}")
        return self


class TransferFunctionFit:
    """Output error in continuous time, see `labrun.fit.transfer.estimation`."""

    Settings: ClassVar[type[BaseModel]] = TransferFunctionSettings

    def __init__(self, settings: TransferFunctionSettings) -> None:
        self._settings = settings

    def __call__(self, job: FitJob) -> TransferSummary:
        """Fit every response, each by itself, and compare neighbouring orders."""
        chosen = self._settings
        shape = Shape(chosen.poles, chosen.zeros, chosen.dead_time, initial=chosen.initial)
        fits, signals = _fitted(job, self._responses(job), shape)
        tables, findings = [], []
        for name, fit in fits.items() if chosen.compare else ():
            job.note(f"comparing other orders for {name}")
            compared, told = compare_orders(fit, name)
            tables.append(compared)
            findings += told
        return summarise("transfer-function", fits, signals, tables=tables, findings=findings)

    def _responses(self, job: FitJob) -> dict[str, ResponseTable]:
        chosen = self._settings
        if chosen.input is not None and chosen.output is not None:
            keys = {key: getattr(chosen, key) for key in ResponseTable.model_fields}
            return {chosen.output.channel.rpartition(".")[2]: ResponseTable(**keys)}
        if not chosen.responses:
            raise RequestError(
                f"which channels of {job.target} are input and output?",
                hint="--set input=CHANNEL --set output=CHANNEL, or [fit.settings.responses.NAME] in the experiment",
            )
        return chosen.responses


def _fitted(
    job: FitJob, responses: dict[str, ResponseTable], shape: Shape
) -> tuple[dict[str, TransferFit], SignalSet]:
    """Return the fit of every response, and the signals of the last."""
    fits = {}
    for name, table in responses.items():
        job.note(f"fitting {name}")
        loaded = load_response(
            job.target, table.input, table.output, where=table.where, from_s=table.from_s, to_s=table.to_s
        )
        fits[name] = fit_transfer(
            loaded.trials,
            shape,
            rng=job.rng,
            starts=job.starts or STARTS,
            input_name=table.input.channel,
            output_name=name,
            input_unit=table.input_unit or loaded.input_unit,
            output_unit=loaded.output_unit,
        )
    return fits, loaded.signals
