"""The fit ``mlp-study``: which layers, activation and solver learn best, how long retraining takes (source, 4.3)."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field, PositiveFloat, PositiveInt, field_validator

from labrun.fit import (
    Curve,
    DataTable,
    FigureData,
    FitJob,
    FitSummary,
    Panel,
    Stack,
    TextTable,
    TrainingSamples,
    WithSettings,
    is_recording,
    known_inverse,
    mean_absolute,
)
from labrun.learned import ACTIVATIONS, Activation, Network, Solver, Training, exact_affine, train

_KEPT = "mlp-study.jsonl"
_WIDTH = 4
_BEST = 12
_AS_GOOD = 1.05
_SHALLOW = 10
_BETTER = 0.98
"""Of two hundredths or less it cannot be told whether they are more than the draw of data and first weights."""


class StudySettings(DataTable):
    """Keys of the study: the data of set A, and what is varied.

    Attributes
    ----------
    retrain_where
        Trials of set B, on which the networks are trained further.
    inverse
        Of the mode "error", which learns what this inverse leaves; without it only the mode "ik" is studied.
    layers
        Numbers n. The source's (4.11) is 1 to 3000 in 151 steps.
    shape
        ``"depth"``: n hidden layers of 4; ``"width"``: one hidden layer of n. The source can be read either way.
    retrainings
        From the weights of set A, each on another half of set B.
    most_iterations
        Of the solver, each time.
    """

    rate_hz: PositiveFloat = 5.0
    retrain_where: dict[str, float | str]
    inverse: str = ""
    layers: Annotated[tuple[PositiveInt, ...], Field(min_length=1)] = (1, 2, 3, 5, 10, 30, 100)
    shape: Literal["depth", "width"] = "depth"
    activations: Annotated[tuple[Activation, ...], Field(min_length=1)] = ACTIVATIONS
    solvers: Annotated[tuple[Solver, ...], Field(min_length=1)] = ("lbfgs", "adam")
    retrainings: PositiveInt = 20
    alpha: float = 1e-6
    most_iterations: PositiveInt = 500

    _inverse_there = field_validator("inverse")(known_inverse)

    @property
    def counted(self) -> str:
        """What n counts."""
        return "layers" if self.shape == "depth" else "neurons"


@dataclass(frozen=True, slots=True)
class Row:
    """One configuration of the study; errors are mean absolute ones on withheld data, in the outputs' unit.

    Attributes
    ----------
    trained
        On set A.
    retrained, spread
        On set B after retraining: mean and standard deviation over the retrainings.
    retraining_s
        Mean time of one.
    """

    mode: str
    layers: int
    activation: str
    solver: str
    trained: float
    retrained: float
    spread: float
    retraining_s: float

    @property
    def name(self) -> str:
        """What it is called in a table."""
        return f"{self.layers} x {self.activation}, {self.solver}"


class MlpStudy(WithSettings[StudySettings]):
    """Every combination of layers, activation and solver, trained on set A and further on set B."""

    Settings: ClassVar[type[BaseModel]] = StudySettings

    def __call__(self, job: FitJob) -> FitSummary:
        """Study; what was done by an earlier call that was interrupted is not done again."""
        settings = self._settings
        first = settings.load(job)
        second = settings.model_copy(update={"where": settings.retrain_where}).load(job)
        modes = (["error"] if settings.inverse else []) + ["ik"]
        seed = int(job.rng.integers(2**31))
        kept = _Kept(
            job.target,
            {"seed": seed, **settings.model_dump(mode="json", exclude={"layers", "activations", "solvers"})},
        )
        rows: list[Row] = []
        affine: dict[str, float] = {}
        grid = list(product(modes, settings.layers, settings.activations, settings.solvers))
        for mode in modes:
            sets = [
                mode_set.residual_to(settings.inverse if mode == "error" else "")
                for mode_set in (first, second)
            ]
            affine[mode] = _error(exact_affine(*sets[1].training), sets[1])
            for _, layers, activation, solver in (pair for pair in grid if pair[0] == mode):
                key = (mode, layers, activation, solver)
                row = kept.rows.get(key)
                if row is None:
                    job.note(
                        f"{len(rows) + 1} of {len(grid)}: {mode}, {layers} {settings.counted}, {activation}, {solver}"
                    )
                    row = _row(settings, key, sets[0], sets[1], seed)
                    kept.keep(row)
                rows.append(row)
        return _summary(settings, first, rows, affine)


def _row(
    settings: StudySettings,
    key: tuple[str, int, Activation, Solver],
    first: TrainingSamples,
    second: TrainingSamples,
    seed: int,
) -> Row:
    mode, layers, activation, solver = key
    hidden = (_WIDTH,) * layers if settings.shape == "depth" else (layers,)
    training = Training(hidden, activation, solver, settings.alpha, settings.most_iterations)
    begin, _ = train(training, *first.training, seed=seed)
    x, y = second.training
    rng = np.random.default_rng(seed)
    errors, times = [], []
    for number in range(settings.retrainings):
        half = rng.permutation(len(x))[: len(x) // 2]
        again, took_s = train(training, x[half], y[half], seed=seed + number, start=begin)
        errors.append(_error(again, second))
        times.append(took_s)
    return Row(
        mode, layers, activation, solver, _error(begin, first),
        float(np.mean(errors)), float(np.std(errors)), float(np.mean(times)),
    )  # fmt: skip


def _error(network: Network, samples: TrainingSamples) -> float:
    x, y = samples.testing
    return mean_absolute(network(x) - y) if network.finite else float("inf")


class _Kept:
    """Rows of a study as they are found, a line each, in the run's folder."""

    def __init__(self, target: Path, settings: Mapping[str, object]) -> None:
        self._file = None if is_recording(target) or not target.is_dir() else target / "fit" / _KEPT
        self._head = json.dumps(settings, sort_keys=True)
        self.rows: dict[tuple[str, int, str, str], Row] = {
            (row.mode, row.layers, row.activation, row.solver): row for row in self._read()
        }

    def keep(self, row: Row) -> None:
        """Add a row."""
        if self._file is None:
            return
        self._file.parent.mkdir(exist_ok=True)
        with self._file.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"of": self._head, **asdict(row)}) + "\n")

    def _read(self) -> Iterator[Row]:
        if self._file is None or not self._file.is_file():
            return
        for line in self._file.read_text(encoding="utf-8").splitlines():
            try:
                stored = json.loads(line)
            except json.JSONDecodeError:  # the line that was being written when it was interrupted
                continue
            if stored.pop("of", None) == self._head:
                yield Row(**stored)


def _summary(
    settings: StudySettings, samples: TrainingSamples, rows: Sequence[Row], affine: Mapping[str, float]
) -> FitSummary:
    unit = settings.unit or "1"
    tables, findings = [], []
    for mode, reference in affine.items():
        mine = sorted((row for row in rows if row.mode == mode), key=lambda row: row.retrained)
        cells = [
            (
                row.name,
                f"{row.trained:.4g}",
                f"{row.retrained:.4g}",
                f"{row.spread:.2g}",
                f"{row.retraining_s:.2g}",
            )
            for row in mine[:_BEST]
        ]
        more = f", the best {_BEST} of {len(mine)}" if len(mine) > _BEST else ""
        head = (settings.counted, "set A", "set B", "spread", "retraining (s)")
        tables.append(
            TextTable(f"mode {mode}: mean absolute error on withheld data, {unit}{more}", head, tuple(cells))
        )
        findings.append(f"mode {mode}: exact affine least squares leaves {reference:.4g} {unit} on set B")
        findings += _findings(mode, mine, reference, settings.counted)
    return FitSummary(
        method="mlp-study",
        model_name="mlp-study",
        data=samples.data,
        parameters={},
        tables=tuple(tables),
        findings=tuple(findings),
        details={"rows": [asdict(row) for row in rows], "exact_affine": dict(affine)},
        figure_data=lambda: _figure(rows, affine, unit, settings.counted),
    )


def _findings(mode: str, rows: Sequence[Row], reference: float, counted: str) -> Iterator[str]:
    plain = [row for row in rows if row.activation == "identity" and row.solver == "lbfgs"]
    shallow = [row for row in plain if row.layers <= _SHALLOW]
    if shallow:
        worst = max(shallow, key=lambda row: row.retrained)
        verb = "reaches" if worst.retrained <= _AS_GOOD * reference else "does not reach"
        yield (
            f"mode {mode}: identity with L-BFGS {verb} it within 5 % at 1 to {_SHALLOW} {counted}: at worst "
            f"{worst.retrained / reference:.3f} of it ({worst.layers} {counted})"
        )
    lbfgs, adam = (
        min((row.retrained for row in rows if row.solver == solver), default=float("nan"))
        for solver in ("lbfgs", "adam")
    )
    if np.isfinite(lbfgs) and np.isfinite(adam):
        share = adam / lbfgs
        word = "better" if share < _BETTER else "not better" if share >= 1.0 else "no better than by chance"
        yield f"mode {mode}: Adam is {word}: {adam:.4g} at best, L-BFGS {lbfgs:.4g}"
    deep = sorted(plain, key=lambda row: row.layers)
    if len(deep) > 1:  # others end at once where they are so deep that nothing comes through
        first, last = deep[0], deep[-1]
        yield (
            f"mode {mode}: a retraining takes {first.retraining_s:.2g} s with {first.layers} and "
            f"{last.retraining_s:.2g} s with {last.layers} {counted} (identity, L-BFGS)"
        )


def _figure(rows: Sequence[Row], affine: Mapping[str, float], unit: str, counted: str) -> FigureData:
    panels = []
    for mode, reference in affine.items():
        mine = sorted((row for row in rows if row.mode == mode), key=lambda row: row.layers)
        ways = dict.fromkeys((row.activation, row.solver) for row in rows if row.mode == mode)
        curves, times = [], []
        for number, (activation, solver) in enumerate(ways):
            chosen = [row for row in mine if (row.activation, row.solver) == (activation, solver)]
            x, errors, took_s = (
                np.array([getattr(row, key) for row in chosen], dtype=float)
                for key in ("layers", "retrained", "retraining_s")
            )
            label, dashed = f"{activation}, {solver}", solver == "adam"
            curves.append(Curve(x, errors, number // 2, label, dashed=dashed))
            times.append(Curve(x, took_s, number // 2, dashed=dashed))
        ends = np.array([mine[0].layers, mine[-1].layers], dtype=float)
        curves.append(Curve(ends, np.full(2, reference), "limit", "exact affine", bold=True))
        above = Panel(
            tuple(curves), title=f"mode {mode}", y_label=f"error on set B, {unit}", log="xy", height=1.6
        )
        below = Panel(tuple(times), x_label=counted, y_label="retraining, s", log="xy")
        panels.append(Stack((above, below)))
    return FigureData(f"{counted}, activation and solver", (tuple(panels),), legend="top", row_height_in=6.0)
