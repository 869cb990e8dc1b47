"""The fit ``mlp``: networks learned from a run, their error on withheld trials, and exact least squares beside it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
    field_validator,
)

from labrun import registry
from labrun.arrays import FloatArray
from labrun.errors import FitError, PluginError, RequestError
from labrun.experiment import loads_experiment
from labrun.fit.method import FitJob, WithSettings
from labrun.fit.result import Curve, FigureData, FitSummary, FittedData, Panel, Stack, TextTable
from labrun.fit.signals import SignalTable, joined, load_signals
from labrun.learned import (
    INVERSES,
    Activation,
    LearnedModel,
    Network,
    Solver,
    Training,
    exact_affine,
    files_of,
    load_inverse,
    train,
)
from labrun.store import open_run
from labrun.toml import UNITS, Keys

_FEWEST = 50
_BLOCKS = 10
_FEW_TRIALS = 3


@dataclass(frozen=True, slots=True)
class TrainingSamples:
    """Inputs and outputs of shape (n, k), and which of them are withheld from training.

    Attributes
    ----------
    withheld : (n,)
        Of whole trials, or of blocks of time where there are too few trials to withhold some.
    input_units, output_units
        By name, in the order of the columns.
    data, data_note
        What the fit says it was made of, and what of it was withheld.
    """

    inputs: FloatArray
    outputs: FloatArray
    withheld: NDArray[np.bool_]
    input_units: Mapping[str, str]
    output_units: Mapping[str, str]
    data: FittedData
    data_note: str

    @property
    def training(self) -> tuple[FloatArray, FloatArray]:
        """What may be learned from."""
        return self.inputs[~self.withheld], self.outputs[~self.withheld]

    @property
    def testing(self) -> tuple[FloatArray, FloatArray]:
        """What is withheld."""
        return self.inputs[self.withheld], self.outputs[self.withheld]

    def residual_to(self, inverse: str) -> "TrainingSamples":
        """Return them with what an analytic inverse of the inputs leaves of the outputs; all of it without a name."""
        if not inverse:
            return self
        nominal = load_inverse(inverse)
        nominals = np.array([nominal(row) for row in self.inputs.tolist()], dtype=np.float64)
        return replace(self, outputs=np.asarray(self.outputs - nominals))


def mean_absolute(error: FloatArray) -> float:
    """Return the mean magnitude over samples and outputs."""
    return float(np.mean(np.abs(error)))


_SHOWN = 600


def known_inverse(name: str) -> str:
    """Return the name of an inverse, or of none; ValueError if there is none of that name."""
    if name:
        try:
            load_inverse(name)
        except PluginError as error:
            raise ValueError(
                f"expected an inverse that is installed: {', '.join(registry.names(INVERSES))}"
            ) from error
    return name


class NetworkTable(Keys):
    """One network of a fit.

    Attributes
    ----------
    hidden
        Neurons of each hidden layer.
    inverse
        Learn what this analytic inverse leaves, instead of the outputs themselves.
    """

    hidden: tuple[PositiveInt, ...] = (4, 4)
    activation: Activation = "identity"
    solver: Solver = "lbfgs"
    alpha: NonNegativeFloat = 1e-4
    most_iterations: PositiveInt = 2000
    inverse: str = ""

    _inverse_there = field_validator("inverse")(known_inverse)

    @property
    def training(self) -> Training:
        """How it is trained."""
        return Training(self.hidden, self.activation, self.solver, self.alpha, self.most_iterations)


class DataTable(Keys):
    """Which signals are learned from and to.

    Attributes
    ----------
    inputs, outputs
        Signals by the names that loops have for them: components of a feedback, and drives.
    unit
        Of the outputs.
    where
        Only trials whose condition has these values.
    rate_hz
        Of the time base.
    withhold
        Share of the trials that is withheld from training.
    """

    inputs: Annotated[dict[str, SignalTable], Field(min_length=1)]
    outputs: Annotated[dict[str, SignalTable], Field(min_length=1)]
    unit: str = ""
    where: dict[str, float | str] = Field(default_factory=dict)
    rate_hz: PositiveFloat = 20.0
    withhold: Annotated[float, Field(gt=0, lt=1)] = 0.25

    def load(self, job: FitJob) -> TrainingSamples:
        """Load a run's samples; a share of its trials is withheld, drawn by lot.

        Where there are fewer than three trials, every trial is cut into ten blocks of time, and blocks are withheld.
        Channels of the dimension of `unit` are converted. Raises RequestError, FitError: as `load_signals`; a name that
        is both input and output; an output of another dimension; too few samples.
        """
        wanted = joined(self.inputs, self.outputs)
        signals = load_signals(job.target, wanted, where=self.where, rate_hz=self.rate_hz, check=job.check)
        factors = [_factor(signals.units[name], self.unit, name) for name in self.outputs]
        x = [np.column_stack([trial.values[name] for name in self.inputs]) for trial in signals.trials]
        y = [
            np.column_stack([trial.values[name] for name in self.outputs]) * factors
            for trial in signals.trials
        ]
        enough = len(x) >= _FEW_TRIALS
        owner = [
            np.full(len(x_value), i)
            if enough
            else i * _BLOCKS + np.arange(len(x_value)) * _BLOCKS // len(x_value)
            for i, x_value in enumerate(x)
        ]
        group = np.concatenate(owner)
        names = np.unique(group)
        out = job.rng.permutation(names)[: min(max(1, round(self.withhold * len(names))), len(names) - 1)]
        withheld = np.isin(group, out)
        if np.count_nonzero(~withheld) < _FEWEST:
            raise FitError(f"{job.target}: fewer than {_FEWEST} samples to learn from", hint="record longer")
        return TrainingSamples(
            np.concatenate(x),
            np.concatenate(y),
            withheld,
            {name: signals.units[name] or "1" for name in self.inputs},
            dict.fromkeys(self.outputs, self.unit),
            FittedData.of(signals),
            f"{len(out)} of {len(names)} {'trials' if enough else 'blocks of time'} withheld",
        )


class MlpSettings(DataTable):
    """Keys of the fit: the data, and networks by name; each is written as NAME.toml and NAME.npz."""

    networks: Annotated[dict[str, NetworkTable], Field(min_length=1)] = Field(
        default_factory=lambda: {"mlp": NetworkTable()}
    )


@dataclass(frozen=True, slots=True)
class Fitted:
    """A trained network beside the exact affine map; `errors` are mean absolute ones, as they are stored.

    Of the training samples ("trained"), and of the withheld ones by the network ("withheld"), by the affine map
    ("affine_withheld") and with no network at all ("without"): of the inverse alone, or of the mean.
    """

    network: Network
    took_s: float
    errors: Mapping[str, float]


class MlpFit(WithSettings[MlpSettings]):
    """Networks by scikit-learn (source, sections 4.2 and 4.3)."""

    Settings: ClassVar[type[BaseModel]] = MlpSettings

    def __call__(self, job: FitJob) -> FitSummary:
        """Train every network."""
        settings = self._settings
        samples = settings.load(job)
        rig, origin = _origin_of(job.target)
        fitted: dict[str, Fitted] = {}
        files: dict[str, str | bytes] = {}
        for name, table in settings.networks.items():
            job.note(f"training {name}")
            network = fitted[name] = fit_network(samples, table, int(job.rng.integers(2**31)))
            made = {
                **origin,
                "solver": table.solver,
                "samples": int(np.count_nonzero(~samples.withheld)),
                "mean_absolute_error_withheld": network.errors["withheld"],
                "exact_affine_withheld": network.errors["affine_withheld"],
            }
            learned = LearnedModel(
                network.network, samples.input_units, samples.output_units, rig, table.inverse, made
            )
            files |= files_of(learned, name)
        return _summary(settings, samples, fitted, files)


def fit_network(samples: TrainingSamples, table: NetworkTable, seed: int) -> Fitted:
    """Train a network, and solve the affine least squares on the same samples.

    Raises FitError: the training did not come to finite weights.
    """
    samples = samples.residual_to(table.inverse)
    network, took_s = train(table.training, *samples.training, seed=seed)
    if not network.finite:
        raise FitError("the training came to weights that are not finite", hint="try another solver")
    x, y = samples.testing
    idle = y - (0.0 if table.inverse else samples.training[1].mean(axis=0))
    errors = {
        "trained": mean_absolute(network(samples.training[0]) - samples.training[1]),
        "withheld": mean_absolute(network(x) - y),
        "affine_withheld": mean_absolute(exact_affine(*samples.training)(x) - y),
        "without": mean_absolute(idle),
    }
    return Fitted(network, took_s, errors)


def _origin_of(target: Path) -> tuple[str, dict[str, Any]]:
    """Return the scene that a run's experiment names, and where its data come from: run, git commit."""
    run = open_run(target)
    scene = loads_experiment(run.experiment_toml, run.name, plugins=False).experiment.rig.scene
    folder = target if target.is_dir() else target.parent
    record: dict[str, Any] = {"run": folder.resolve().name}
    provenance = folder / "provenance.json"
    if provenance.is_file():
        git = json.loads(provenance.read_text(encoding="utf-8")).get("git") or {}
        record |= {"git": str(git.get("commit", "")), "changed_files": int(git.get("changed_files", 0) or 0)}
    return "" if scene is None else scene.plugin, record


def _factor(given: str, wanted: str, name: str) -> float:
    """Return what turns numbers of a unit into those of another. Raises RequestError: of another dimension."""
    if not wanted or given == wanted:
        return 1.0
    sizes = {item.label: item for item in UNITS.values()}
    first, other = sizes.get(given), sizes.get(wanted)
    if first is None or other is None or first.dimension != other.dimension:
        raise RequestError(f"{name} is recorded in {given or 'no unit'}, expected {wanted}", hint="set unit")
    return float(first.si / other.si)


def _summary(
    settings: MlpSettings,
    samples: TrainingSamples,
    fitted: Mapping[str, Fitted],
    files: Mapping[str, str | bytes],
) -> FitSummary:
    unit = settings.unit or "1"
    rows, findings = [], []
    for name, learner in fitted.items():
        table = settings.networks[name]
        trained, withheld, affine, idle = (f"{error:.4g}" for error in learner.errors.values())
        what = f"{table.activation}, {'-'.join(map(str, table.hidden))}, {table.solver}"
        idle += f" ({'inverse alone' if table.inverse else 'the mean'})"
        rows.append((name, what, trained, withheld, affine, idle, f"{learner.took_s:.3g}"))
        ratio = learner.errors["withheld"] / learner.errors["affine_withheld"]
        findings.append(
            f"{name}: on withheld data {learner.errors['withheld']:.3g} {unit} off on average, {ratio:.2f} "
            "of what exact "
            f"affine least squares leaves ({learner.errors['affine_withheld']:.3g} {unit}), in {learner.took_s:.2g} s"
        )
    head = ("network", "layers", "trained", "withheld", "exact affine", "without", "training (s)")
    return FitSummary(
        method="mlp",
        model_name="mlp",
        data=samples.data,
        parameters={},
        tables=(TextTable(f"mean absolute error, {unit}; {samples.data_note}", head, tuple(rows)),),
        findings=(*findings, _TAKEN_OVER),
        details={
            "errors": {
                name: {**learner.errors, "training_s": learner.took_s} for name, learner in fitted.items()
            }
        },
        files=files,
        figure_data=lambda: _figure(settings, samples, fitted),
    )


_TAKEN_OVER = (
    'to let a loop take a network, copy its TOML file and the npz beside it to where model = "..." of the controller '
    "points"
)


def _figure(settings: MlpSettings, samples: TrainingSamples, fitted: Mapping[str, Fitted]) -> FigureData:
    unit, rows = settings.unit or "1", []
    for name, learner in fitted.items():
        inverse = settings.networks[name].inverse
        inputs, wanted = (part[:_SHOWN] for part in samples.residual_to(inverse).testing)
        time_s: FloatArray = np.arange(len(wanted), dtype=np.float64) / settings.rate_hz
        stacks = []
        for output, measured, predicted in zip(
            settings.outputs, wanted.T, learner.network(inputs).T, strict=True
        ):
            above = Panel(
                (Curve(time_s, measured, "measured", "withheld data"), Curve(time_s, predicted, "fitted", "network")),
                title=f"{name}: {output}",
                y_label=f"{output}{' less inverse' if inverse else ''}, {unit}", height=2.0,
            )  # fmt: skip
            below = Panel(
                (Curve(time_s, measured - predicted, "residual"),), x_label="time of the withheld data, s",
                y_label=f"error, {unit}", zero=True,
            )  # fmt: skip
            stacks.append(Stack((above, below)))
        rows.append(tuple(stacks))
    withheld_s, shown_s = (count / settings.rate_hz for count in (len(samples.testing[0]) - 1, _SHOWN))
    part = f"\nThe first {shown_s:g} of {withheld_s:.3g} s that were withheld" if withheld_s > shown_s else ""
    return FigureData(
        f"Networks on data they were not trained with{part}", tuple(rows), legend="top", row_height_in=4.2
    )
