"""The experiment file, as data. One class a table of the file; units stand in the names."""

from collections.abc import Mapping
from typing import Any, Literal, get_args

from pydantic import Field, PositiveFloat, ValidationInfo, field_validator, model_validator

from labrun.experiment.condition import Value
from labrun.experiment.loop_tables import Track
from labrun.experiment.raw import condition_units
from labrun.experiment.search_tables import CmaEs, Combine, Design, Leaders, RunTable, Sweep
from labrun.experiment.specimens import ByHand, DamageTable
from labrun.experiment.trial_tables import CYCLES, TrialTable
from labrun.toml import Expression, PluginTable, Table, TableFaults

ROBOT_FILES = (".xml", ".mjcf", ".urdf")
ROBOT_SCENE = "robot"
"""The scene that simulates an MJCF or URDF file."""


class SceneTable(PluginTable):
    """What a dry run simulates; ``scene = "name"`` is short for ``scene.plugin = "name"``."""


def written_out(scene: str) -> dict[str, str]:
    """Return the table that ``scene = "name"`` or ``scene = "arm.xml"`` is short for."""
    if scene.lower().endswith(ROBOT_FILES):
        return {"plugin": ROBOT_SCENE, "model": scene}
    return {"plugin": scene}


class RigTable(Table):
    """The bench: its devices, and the scene of a dry run."""

    scene: SceneTable | None = None
    devices: dict[str, PluginTable]
    watchdog_s: PositiveFloat = 2.0

    @model_validator(mode="before")
    @classmethod
    def _short_scene(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("scene"), str):
            return {**data, "scene": written_out(data["scene"])}
        return data


STILL = "hold"
"""The gait that may do without joints: nothing is driven."""


class GaitTable(PluginTable):
    """Parameters to joint motion. `joints` and `let` hold expressions."""

    joints: dict[str, dict[str, Expression]] = Field(default_factory=dict)
    let: dict[str, Expression] = Field(default_factory=dict)
    command_rate_hz: PositiveFloat = 100.0


class ObjectiveTable(PluginTable):
    """A number from the recorded signals."""

    channel: str | None = None
    goal: Literal["maximise", "minimise"] | None = None


class FitTable(Table):
    """What `labrun fit` does with this experiment's runs.

    `method` is a fit by name (an entry point of group labrun.fits); `model` a model file or plugin; `signals` maps the
    model's inputs and outputs to recorded channels ("cameras.angle", "command.tail"). `settings` are the method's own
    keys. Another method, asked for by ``labrun fit --model NAME``, takes those of them that it knows too, and its own
    from `methods`. `after_run` fits a run as soon as it is finished.
    """

    method: str = "model"
    model: str | None = None
    signals: dict[str, str] = Field(default_factory=dict)
    settings: Mapping[str, Any] = Field(default_factory=dict)
    methods: dict[str, Mapping[str, Any]] = Field(default_factory=dict)
    after_run: bool = False


class GapTable(Table):
    """What a run is compared with by default: the model that a person at this bench would have.

    `model` and `signals` are as in `FitTable`. ``--hide random`` draws among what this model could lack. `repeats`
    names conditions that tell repeats of one thing apart, as numbers of specimens do; a diagnosis does not. A trial
    counts up to where the output `until_peak` of the model is greatest: what breaks there is another thing afterwards.
    It counts up to `until_s`, and so many of its samples that they are `rate_hz` a second.
    """

    model: str
    signals: dict[str, str] = Field(default_factory=dict)
    repeats: list[str] = Field(default_factory=list)
    until_peak: str | None = None
    until_s: PositiveFloat | None = None
    rate_hz: PositiveFloat | None = None


Kind = Literal["run", "sweep", "cmaes", "track", "design"]
"""What an experiment does; its table has the same name."""


class Experiment(Table):
    """A whole experiment file."""

    title: str
    kind: Kind
    rig: RigTable
    gait: GaitTable = GaitTable(plugin=STILL)
    """Without one nothing moves but, perhaps, the carriage."""
    trial: TrialTable
    by_hand: ByHand | None = None
    damage: DamageTable | None = None
    run: RunTable | None = None
    sweep: Sweep | None = None
    cmaes: CmaEs | None = None
    track: Track | None = None
    design: Design | None = None
    leaders: Leaders = Leaders()
    objectives: dict[str, ObjectiveTable] = Field(default_factory=dict)
    fit: FitTable | None = None
    gap: GapTable | None = None
    units: dict[str, str] = Field(default_factory=dict)
    """Units of conditions and variables, for tables and figures: as the file states them, see `condition_units`."""

    @field_validator("objectives", mode="after")
    @classmethod
    def _cycles_are_counted(
        cls, objectives: dict[str, ObjectiveTable], info: ValidationInfo
    ) -> dict[str, ObjectiveTable]:
        trial = info.data.get("trial")
        if trial is None or trial.until is None or CYCLES in objectives:
            return objectives
        return {**objectives, CYCLES: ObjectiveTable(plugin=CYCLES)}

    @model_validator(mode="before")
    @classmethod
    def _simulated_without_rig(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("kind") == "design" and "rig" not in data:
            return {**data, "rig": {"devices": {}}}
        return data

    @model_validator(mode="before")
    @classmethod
    def _units_by_keys(cls, data: Any) -> Any:
        if not isinstance(data, dict) or not isinstance(data.get("units", {}), dict):
            return data
        return {**data, "units": condition_units(data)}

    @model_validator(mode="after")
    def _kind_has_its_table(self) -> "Experiment":
        with TableFaults() as faults:
            if getattr(self, self.kind) is None:
                others = [kind for kind in get_args(Kind) if getattr(self, kind) is not None]
                instead = f', or write kind = "{others[0]}", whose table is there' if others else ""
                faults.add("kind", f"an experiment of this kind needs a table [{self.kind}]; add it{instead}")
            goals = [name for name, objective in self.objectives.items() if objective.goal is not None]
            if self.kind != "design" and not self.rig.devices:
                faults.add(("rig", "devices"), "a bench needs at least one device")
            if self.kind == "design" and self.rig.devices:
                faults.add(("rig", "devices"), "a design is simulated and has no devices; remove [rig]")
            if self.kind in ("cmaes", "design") and not goals:
                faults.add("kind", 'a search needs an objective with goal = "maximise" or "minimise"')
            if self.leaders.beside and (self.kind == "design" or not goals):
                message = "needs an objective with a goal, and a bench: they give leaders of its own to compare with"
                faults.add(("leaders", "beside"), message)
            for name in goals[1:]:
                faults.add(
                    ("objectives", name, "goal"),
                    f"{goals[0]} has a goal already, and only one objective can have one; remove a goal",
                )
        return self

    @property
    def over(self) -> Mapping[str, list[Value]]:
        """Settings that each of its conditions is measured at; empty if there is one measurement of each."""
        table = {"run": self.run, "sweep": self.sweep, "cmaes": self.cmaes}.get(self.kind)
        return {} if table is None else table.over

    @property
    def each(self) -> Mapping[str, list[Value]]:
        """Factors with a separate search for each combination of levels; empty for one search."""
        return {} if self.cmaes is None or self.kind != "cmaes" else self.cmaes.each

    @property
    def combine(self) -> Combine:
        """What becomes of the values at the settings of `over`."""
        table = {"run": self.run, "sweep": self.sweep, "cmaes": self.cmaes}.get(self.kind)
        return "mean" if table is None else table.combine

    @property
    def search(self) -> CmaEs | None:
        """The table of a search, on the bench or of a design; None if this experiment is no search."""
        return {"cmaes": self.cmaes, "design": self.design}.get(self.kind)

    @property
    def goal(self) -> tuple[str, Literal["maximise", "minimise"]] | None:
        """The objective with a goal, and its direction; None if no objective has one."""
        for name, objective in self.objectives.items():
            if objective.goal is not None:
                return name, objective.goal
        return None
