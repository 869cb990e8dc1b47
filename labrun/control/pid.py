"""PID controllers: alone, and with a feedforward."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, PositiveFloat, Tag, model_validator

from labrun.control.plant import PlantModel, read_plant
from labrun.control.protocol import FindFile, LoopContext, Step
from labrun.errors import SpecError
from labrun.toml import Table, TableFaults, checked


class PidSettings(Table):
    """Keys of `pid`; gains are in the unit of the variable per unit of the feedback.

    Attributes
    ----------
    p, i, d
        Gains. `i` counts per second, or per sample: the source's Table 5.4 behaves as described only if it is summed
        once a sample. `d` is per second always.
    i_per
        ``"second"`` or ``"sample"``.
    bias
        Added to the output.
    derivative_on
        ``"measurement"``, so that a step of the reference makes no kick, or ``"error"``.
    filter_s
        Time constant of the derivative's first-order filter; two steps, if not given.
    anti_windup
        ``"conditional"``: the integral stands while the output is beyond the range and the error drives it further.
        ``"back-calculation"``: it follows what was really applied, within `tracking_s`. ``"none"``.
    tracking_s
        Of back-calculation; the integral time p/i, if not given.
    output
        ``"absolute"``, or ``"increment"``: what is computed is added to the variable as it stands.
    """

    p: float = 0.0
    i: float = 0.0
    d: float = 0.0
    i_per: Literal["second", "sample"] = "second"
    bias: float = 0.0
    derivative_on: Literal["measurement", "error"] = "measurement"
    filter_s: Annotated[float, Field(ge=0)] | None = None
    anti_windup: Literal["conditional", "back-calculation", "none"] = "conditional"
    tracking_s: PositiveFloat | None = None
    output: Literal["absolute", "increment"] = "absolute"


class PidController:
    """``bias + p e + i sum(e) + d de/dt``, bounded as the loop's range asks for.

    Anti-windup by conditional integration and by back-calculation: Astrom and Murray, Feedback Systems (2008), section
    10.4; derivative of the filtered measurement: section 10.5.

    Parameters
    ----------
    context
        The loop's period, range and start.
    """

    Settings: ClassVar[type[PidSettings]] = PidSettings
    keys: PidSettings

    def __init__(self, settings: Mapping[str, Any], context: LoopContext) -> None:
        self.keys = checked(self.Settings, settings)
        self._low, self._high = context.low, context.high
        filter_s = self.keys.filter_s
        self.filter_s = 2.0 * context.period_s if filter_s is None else filter_s
        self.tracking_s = self.keys.tracking_s or _integral_time_s(self.keys, context.period_s)
        self._integral = 0.0
        self._rate = 0.0
        self._before: float | None = None
        self._requested = 0.0
        self._dt_s = context.period_s

    def update(self, step: Step) -> float:
        """Return the output for one step; see `labrun.control.protocol.Controller`."""
        keys = self.keys
        self._dt_s = step.dt_s
        base = self._feedforward(step) + keys.bias + keys.p * step.error + keys.d * self._derivative(step)
        if keys.output == "increment":
            base += step.drive
        growth = keys.i * step.error * (step.dt_s if keys.i_per == "second" else 1.0)
        wanted = base + self._integral + growth
        outward = (wanted > self._high and growth > 0) or (wanted < self._low and growth < 0)
        if keys.anti_windup != "conditional" or not outward:
            self._integral += growth
        self._requested = base + self._integral
        return self._requested

    def applied(self, drive: float) -> None:
        """Record the value that the variable was given."""
        if self.keys.anti_windup == "back-calculation" and self.keys.i:
            share = min(1.0, self._dt_s / self.tracking_s)
            self._integral += share * (drive - self._requested)

    def _feedforward(self, step: Step) -> float:  # noqa: ARG002
        return 0.0

    def _derivative(self, step: Step) -> float:
        """Return the filtered rate of the error, or of the negative measurement; zero at the first step."""
        signal = step.error if self.keys.derivative_on == "error" else -step.feedback
        if self._before is not None:
            raw = (signal - self._before) / step.dt_s
            self._rate += (raw - self._rate) * step.dt_s / (self.filter_s + step.dt_s)
        self._before = signal
        return self._rate


def _integral_time_s(keys: PidSettings, period_s: float) -> float:
    """Return p/i in seconds, or one period if the ratio is undefined."""
    per_second = abs(keys.i) if keys.i_per == "second" else abs(keys.i) / period_s
    return max(period_s, abs(keys.p) / per_second) if per_second else period_s


def _form_of_model(model: object) -> str:
    """Select the form of the model, so that errors refer to it."""
    return "file" if isinstance(model, str) else "table"


class FeedforwardSettings(PidSettings):
    """Keys of `feedforward+pid`: those of `pid`, and the model.

    Attributes
    ----------
    model
        Inline, see `PlantModel`, or the path of a TOML file, as ``labrun fit --model fopdt`` or ``transfer-function``
        writes it.
    response
        Which response of a file that holds several.
    lead_s
        The feed-forward looks this far ahead on the reference, which is known; ``"dead"``: by the model's dead time.
    """

    model: Annotated[
        Annotated[PlantModel, Tag("table")] | Annotated[str, Tag("file")], Discriminator(_form_of_model)
    ]
    response: str | None = None
    lead_s: Annotated[float, Field(ge=0)] | Literal["dead"] = 0.0

    @model_validator(mode="after")
    def _response_is_of_a_file(self) -> "FeedforwardSettings":
        with TableFaults() as faults:
            if self.response is not None and isinstance(self.model, PlantModel):
                faults.add("response", "chooses one of a file's responses, and the model is written inline")
        return self


class FeedforwardPid(PidController):
    """The reference over the model's static gain, plus a PID on the error (source, Fig. 5.9 b).

    Parameters
    ----------
    context
        The loop's period, range and start.
    """

    Settings: ClassVar[type[PidSettings]] = FeedforwardSettings
    keys: FeedforwardSettings

    def __init__(self, settings: Mapping[str, Any], context: LoopContext) -> None:
        super().__init__(settings, context)
        keys = self.keys
        if isinstance(keys.model, str):
            raise SpecError(
                f'the model "{keys.model}" is a file, and was not read',
                hint="load the experiment from its file, or write the model inline",
            )
        self._gain = keys.model.static_gain
        self._lead_s = keys.model.dead_s if keys.lead_s == "dead" else float(keys.lead_s)

    @staticmethod
    def embed(settings: Mapping[str, Any], find: FindFile) -> dict[str, Any]:
        """Return the settings with the model that their file holds."""
        model = settings.get("model")
        if not isinstance(model, str):
            return dict(settings)
        response = settings.get("response")
        if response is not None and not isinstance(response, str):
            return dict(settings)  # refused with its place when the settings are checked
        rest = {key: value for key, value in settings.items() if key != "response"}
        return {**rest, "model": read_plant(find(model), response)}

    def _feedforward(self, step: Step) -> float:
        return step.reference_at(step.time_s + self._lead_s) / self._gain
