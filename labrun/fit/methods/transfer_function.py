"""A transfer function of given order."""

from typing import TYPE_CHECKING, Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat, model_validator

from labrun.errors import RequestError
from labrun.fit.method import FitJob
from labrun.fit.methods.fopdt import ResponseTable
from labrun.fit.signal_table import SignalTable
from labrun.fit.transfer.shape import Initial

if TYPE_CHECKING:
    from labrun.fit.summary import FitSummary


class TransferFunctionSettings(BaseModel):
    """Keys of the fit: order, dead time, and either `input` and `output` or `responses`, as fopdt has them."""

    model_config = ConfigDict(extra="forbid", frozen=True)

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

    def __call__(self, job: FitJob) -> "FitSummary":
        """Fit every response, each by itself."""
        from labrun.fit.transfer.fitting import fit_transfer
        from labrun.fit.transfer.loading import load_response
        from labrun.fit.transfer.orders import compare_orders
        from labrun.fit.transfer.shape import Shape
        from labrun.fit.transfer.starts import STARTS
        from labrun.fit.transfer.summary import summarise

        chosen = self._settings
        shape = Shape(chosen.poles, chosen.zeros, chosen.dead_time, initial=chosen.initial)
        fits: dict[str, Any] = {}
        tables, findings = [], []
        for name, table in self._responses(job).items():
            job.note(f"fitting {name}")
            loaded = load_response(
                job.target, table.input, table.output,
                where=table.where, from_s=table.from_s, to_s=table.to_s,
            )  # fmt: skip
            signals = loaded.signals
            fit = fit_transfer(
                loaded.trials,
                shape,
                rng=job.rng,
                starts=job.starts or STARTS,
                input_name=table.input.channel,
                output_name=name,
                input_unit=table.input_unit or loaded.input_unit,
                output_unit=loaded.output_unit,
            )
            fits[name] = fit
            if chosen.compare:
                job.note(f"comparing other orders for {name}")
                compared, said = compare_orders(fit, name)
                tables.append(compared)
                findings += said
        return summarise("transfer-function", fits, signals, tables=tables, findings=findings)

    def _responses(self, job: FitJob) -> dict[str, ResponseTable]:
        chosen = self._settings
        if chosen.input is not None and chosen.output is not None:
            table = ResponseTable(
                input=chosen.input,
                output=chosen.output,
                input_unit=chosen.input_unit,
                where=chosen.where,
                from_s=chosen.from_s,
                to_s=chosen.to_s,
            )
            return {chosen.output.channel.rpartition(".")[2]: table}
        if not chosen.responses:
            raise RequestError(
                f"which channels of {job.target} are input and output?",
                hint="--set input=CHANNEL --set output=CHANNEL, or [fit.settings.responses.NAME] in the experiment",
            )
        return chosen.responses
