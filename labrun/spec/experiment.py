"""The experiment file, as data. One class a table of the file; units stand in the names."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt, model_validator

Number = float | int
Value = float | str
"""A value of a condition: a number, or a word (a specimen's name)."""
Expression = float | str
"""A number, or an expression in the names of conditions, variables and `let`."""


class Table(BaseModel):
    """A table of the file: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class PluginTable(BaseModel):
    """A table that names a plugin; its further keys belong to the plugin, which checks them."""

    model_config = ConfigDict(extra="allow", frozen=True)

    plugin: str

    @property
    def settings(self) -> dict[str, Any]:
        """The plugin's own keys."""
        return dict(self.model_extra or {})


class SceneTable(PluginTable):
    """What a dry run simulates; ``scene = "name"`` is short for ``scene.plugin = "name"``."""


class Rig(Table):
    """The bench: what is connected, and the scene that stands in for it in a dry run."""

    scene: SceneTable | None = None
    devices: dict[str, PluginTable] = Field(min_length=1)
    watchdog_s: PositiveFloat = 2.0

    @model_validator(mode="before")
    @classmethod
    def _short_scene(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("scene"), str):
            return {**data, "scene": {"plugin": data["scene"]}}
        return data


class GaitTable(PluginTable):
    """Parameters to joint motion. `joints` and `let` hold expressions."""

    joints: dict[str, dict[str, Expression]] = Field(min_length=1)
    let: dict[str, Expression] = {}
    command_rate_hz: PositiveFloat = 100.0


class RepeatRule(Table):
    """How often a condition is measured.

    At least `min` times, then until every standard error is small enough, at most `max` times.
    """

    min: PositiveInt
    max: PositiveInt
    standard_error: dict[str, PositiveFloat] = {}

    @model_validator(mode="after")
    def _ordered(self) -> "RepeatRule":
        if self.max < self.min:
            raise ValueError(f"max ({self.max}) is below min ({self.min})")
        return self


class Settle(Table):
    """When the bench counts as at rest.

    `below` bounds spread and drift of the channel, in its SI unit; without it, the bench's own quiet baseline,
    measured before the first trial, is the bound (times `factor`).
    """

    until: Literal["quiet", "time"] = "quiet"
    channel: str | None = None
    below: PositiveFloat | None = None
    factor: PositiveFloat = 1.5
    hold_s: PositiveFloat = 2.0
    timeout_s: PositiveFloat = 60.0
    on_timeout: Literal["go-on", "reject", "stop"] = "go-on"


class Tare(Table):
    """Zero of the force channels, averaged over a quiet moment before each recording. Raw data stay raw."""

    duration_s: PositiveFloat = 1.0
    devices: list[str] | None = None


class Outliers(Table):
    """The outlier rule, declared beforehand. A rejected trial is kept, with its reason."""

    rule: Literal["none", "mad"] = "none"
    objective: str | None = None
    threshold: PositiveFloat = 3.5
    minimum: Annotated[int, Field(ge=3)] = 3


class Reference(Table):
    """A condition measured every so many trials, so that drift of the bench is seen."""

    every: PositiveInt
    condition: dict[str, Value] = Field(min_length=1)


class CarriageMove(Table):
    """The carriage's part in a trial: it goes to `from_m`, and travels at `speed_m_s` while samples are taken."""

    device: str
    speed_m_s: Expression
    from_m: Number = 0.0
    to_m: Number
    return_speed_m_s: PositiveFloat = 0.1


class TrialTable(Table):
    """One trial. Length: `cycles` of the gait (or "fit": as many as the carriage's travel allows), or `duration_s`."""

    cycles: PositiveInt | Literal["fit"] | None = None
    duration_s: PositiveFloat | None = None
    discard_cycles: Annotated[int, Field(ge=0)] = 0
    repeats: RepeatRule = RepeatRule(min=1, max=1)
    settle: Settle | None = None
    tare: Tare | None = None
    outliers: Outliers = Outliers()
    reference: Reference | None = None
    carriage: CarriageMove | None = None
    safe_pose_deg: dict[str, float] = {}
    move_speed_deg_s: PositiveFloat = 60.0
    on_fault: Literal["stop", "retry-trial", "skip"] = "stop"
    retries: Annotated[int, Field(ge=0)] = 1

    @model_validator(mode="before")
    @classmethod
    def _short_repeats(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("repeats"), int):
            return {**data, "repeats": {"min": data["repeats"], "max": data["repeats"]}}
        return data

    @model_validator(mode="after")
    def _one_length(self) -> "TrialTable":
        if (self.cycles is None) == (self.duration_s is None):
            raise ValueError("give either cycles or duration_s")
        if isinstance(self.cycles, int) and self.discard_cycles >= self.cycles:
            raise ValueError(f"discard_cycles ({self.discard_cycles}) leaves nothing of {self.cycles} cycles")
        if self.cycles == "fit" and self.carriage is None:
            raise ValueError('cycles = "fit" needs a carriage, whose travel sets the length')
        return self


class Range(Table):
    """An axis of a grid: from, to and step (both ends included)."""

    start: Number = Field(alias="from")
    stop: Number = Field(alias="to")
    step: PositiveFloat

    @model_validator(mode="after")
    def _ordered(self) -> "Range":
        if self.stop < self.start:
            raise ValueError(f"from ({self.start:g}) is above to ({self.stop:g})")
        return self


class Interval(Table):
    """An axis of a random or Sobol design, or a search variable: from, to."""

    start: Number = Field(alias="from")
    stop: Number = Field(alias="to")

    @model_validator(mode="after")
    def _ordered(self) -> "Interval":
        if not self.start < self.stop:
            raise ValueError(f"from ({self.start:g}) is not below to ({self.stop:g})")
        return self


class RunTable(Table):
    """Conditions one by one."""

    conditions: list[dict[str, Value]] = Field(min_length=1)
    order: Literal["shuffled", "as-listed"] = "shuffled"


class Sweep(Table):
    """Conditions from axes. Grid and list axes cross; random and Sobol designs take `samples` points of intervals."""

    design: Literal["grid", "random", "sobol"] = "grid"
    axes: dict[str, Range | Interval | list[Value]] = Field(min_length=1)
    samples: PositiveInt | None = None
    where: list[str] = []
    order: Literal["shuffled", "as-listed"] = "shuffled"

    @model_validator(mode="after")
    def _design_fits_axes(self) -> "Sweep":
        for name, axis in self.axes.items():
            if isinstance(axis, Interval) and self.design == "grid":
                raise ValueError(f"axis {name} of a grid needs a step")
            if not isinstance(axis, Interval) and self.design != "grid":
                raise ValueError(f"axis {name} of a {self.design} design is {{ from, to }} without step")
        if self.design != "grid" and self.samples is None:
            raise ValueError(f"a {self.design} design needs samples")
        return self


class Variable(Interval):
    """A search variable: its range, and where the search starts (the middle, if not said)."""

    initial: Number | None = None

    @model_validator(mode="after")
    def _initial_inside(self) -> "Variable":
        if self.initial is not None and not self.start <= self.initial <= self.stop:
            raise ValueError(f"initial ({self.initial:g}) is outside {self.start:g} ... {self.stop:g}")
        return self


class Penalty(Table):
    """Cost of an infeasible candidate, which is never run.

    Worst feasible value + spread of the feasible values * (per_violation * number + per_size * size).
    """

    per_violation: PositiveFloat = 1.0
    per_size: PositiveFloat = 1.0


class StopRules(Table):
    """When a search ends, whichever comes first."""

    iterations: PositiveInt = 1000
    stagnation: PositiveInt | None = None
    step_size_below: PositiveFloat | None = None
    trials: PositiveInt | None = None


class Leaders(Table):
    """The honest best: this many leaders get this many fresh repeats each; the winner is confirmed by as many again."""

    count: PositiveInt = 5
    repeats: Annotated[int, Field(ge=2)] = 5


class CmaEs(Table):
    """Covariance matrix adaptation. `step_size` is a share of each variable's range."""

    variables: dict[str, Variable] = Field(min_length=1)
    population: Annotated[int, Field(ge=4)] | None = None
    parents: PositiveInt | None = None
    step_size: PositiveFloat = 0.3
    where: list[str] = []
    penalty: Penalty = Penalty()
    restarts: Annotated[int, Field(ge=0)] = 0
    reevaluate: Annotated[int, Field(ge=0)] = 0
    """Leaders of a generation that are measured again in the next one."""
    stop: StopRules = StopRules()


class ObjectiveTable(PluginTable):
    """A number from the recorded signals."""

    channel: str | None = None
    goal: Literal["maximise", "minimise"] | None = None


class FitTable(Table):
    """What `labrun fit` does with this experiment's runs.

    `method` is a fit by name ("hinge", "model"); `model` a model file or plugin; `signals` maps the model's inputs
    and outputs to recorded channels ("cameras.angle", "command.tail").
    """

    method: str = "model"
    model: str | None = None
    signals: dict[str, str] = {}
    settings: Mapping[str, Any] = {}


class Experiment(Table):
    """A whole experiment file."""

    title: str
    kind: Literal["run", "sweep", "cmaes", "track", "design"]
    rig: Rig
    gait: GaitTable
    trial: TrialTable
    run: RunTable | None = None
    sweep: Sweep | None = None
    cmaes: CmaEs | None = None
    leaders: Leaders = Leaders()
    objectives: dict[str, ObjectiveTable] = {}
    fit: FitTable | None = None
    units: dict[str, str] = {}
    """Units of conditions and variables, for tables and figures."""

    @model_validator(mode="after")
    def _kind_has_its_table(self) -> "Experiment":
        if self.kind in ("run", "sweep", "cmaes") and getattr(self, self.kind) is None:
            raise ValueError(f'kind = "{self.kind}" needs a table [{self.kind}]')
        if self.kind == "cmaes" and self.goal is None:
            raise ValueError('a search needs an objective with goal = "maximise" or "minimise"')
        return self

    @property
    def goal(self) -> tuple[str, Literal["maximise", "minimise"]] | None:
        """The objective that says what is best, and in which direction; None if no objective has a goal."""
        for name, objective in self.objectives.items():
            if objective.goal is not None:
                return name, objective.goal
        return None
