"""What a network learns from: inputs and outputs of a run's trials, some of which are withheld."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import FitError, RequestError
from labrun.fit.result import FittedData
from labrun.fit.signals import SignalTable, joined, load_signals
from labrun.learned import load_inverse
from labrun.spec import loads_experiment
from labrun.store import open_run
from labrun.toml import UNITS

_FEWEST = 50
_BLOCKS = 10
_FEW_TRIALS = 3


@dataclass(frozen=True, slots=True)
class TrainingSamples:
    """Inputs and outputs of shape (n, k), and which of them are withheld from training.

    Attributes
    ----------
    group
        The trial of each sample, or its block of time where there are too few trials to withhold some.
    input_units, output_units
        By name, in the order of the columns.
    data
        What the fit says it was made of.
    """

    inputs: FloatArray
    outputs: FloatArray
    withheld: FloatArray
    group: FloatArray
    input_units: Mapping[str, str]
    output_units: Mapping[str, str]
    data: FittedData
    told: str

    @property
    def training(self) -> tuple[FloatArray, FloatArray]:
        """What may be learned from."""
        kept = self.withheld == 0
        return self.inputs[kept], self.outputs[kept]

    @property
    def testing(self) -> tuple[FloatArray, FloatArray]:
        """What is withheld."""
        kept = self.withheld == 1
        return self.inputs[kept], self.outputs[kept]


def load_samples(
    target: Path,
    inputs: Mapping[str, SignalTable],
    outputs: Mapping[str, SignalTable],
    *,
    unit: str,
    where: Mapping[str, float | str],
    rate_hz: float,
    withhold: float,
    rng: np.random.Generator,
) -> TrainingSamples:
    """Load a run's samples; a share of its trials is withheld, drawn by lot.

    Where there are fewer than three trials, every trial is cut into ten blocks of time, and blocks are withheld.
    `unit`: of the outputs: what the loop's drives are in. Channels of the same dimension are converted. Raises
    RequestError, FitError: as `load_signals`; a name that is both input and output; an output of another dimension; too
    few samples.
    """
    signals = load_signals(target, joined(inputs, outputs), where=where, rate_hz=rate_hz)
    factors = [_factor(signals.units[name], unit, name) for name in outputs]
    x = [np.column_stack([trial.values[name] for name in inputs]) for trial in signals.trials]
    y = [np.column_stack([trial.values[name] for name in outputs]) * factors for trial in signals.trials]
    enough = len(x) >= _FEW_TRIALS
    owner = [
        np.full(len(one), float(i)) if enough else i * _BLOCKS + np.arange(len(one)) * _BLOCKS // len(one)
        for i, one in enumerate(x)
    ]
    group = np.concatenate(owner)
    names = np.unique(group)
    out = rng.permutation(names)[: min(max(1, round(withhold * len(names))), len(names) - 1)]
    samples = TrainingSamples(
        np.concatenate(x),
        np.concatenate(y),
        np.isin(group, out).astype(float),
        group,
        {name: signals.units[name] or "1" for name in inputs},
        dict.fromkeys(outputs, unit),
        FittedData(signals.name, signals.kind, len(signals.trials), signals.left_out),
        f"{len(out)} of {len(names)} {'trials' if enough else 'blocks of time'} withheld",
    )
    if np.count_nonzero(samples.withheld == 0) < _FEWEST:
        raise FitError(f"{target}: fewer than {_FEWEST} samples to learn from", hint="record longer")
    return samples


def corrected(samples: TrainingSamples, inverse: str) -> FloatArray:
    """Return what is left of the outputs after an analytic inverse of the inputs: what error learning learns."""
    nominal = load_inverse(inverse)
    found = np.array([nominal(row) for row in samples.inputs.tolist()], dtype=np.float64)
    return np.asarray(samples.outputs - found)


def origin_of(target: Path) -> tuple[str, dict[str, Any]]:
    """Return the scene that a run's experiment names, and where its data come from: run, git commit."""
    run = open_run(target)
    experiment = loads_experiment(run.experiment_toml, run.name, plugins=False).experiment
    scene = experiment.rig.scene
    folder = target if target.is_dir() else target.parent
    found: dict[str, Any] = {"run": folder.resolve().name}
    provenance = folder / "provenance.json"
    if provenance.is_file():
        git = json.loads(provenance.read_text(encoding="utf-8")).get("git") or {}
        found |= {"git": str(git.get("commit", "")), "changed_files": int(git.get("changed", 0) or 0)}
    return "" if scene is None else scene.plugin, found


def mean_absolute(error: FloatArray) -> float:
    """Return the mean magnitude over samples and outputs."""
    return float(np.mean(np.abs(error)))


def _factor(given: str, wanted: str, name: str) -> float:
    if not wanted or given == wanted:
        return 1.0
    sizes = {item.label: item for item in UNITS.values()}
    one, other = sizes.get(given), sizes.get(wanted)
    if one is None or other is None or one.dimension != other.dimension:
        raise RequestError(
            f"{name} is recorded in {given or 'no unit'}, which is no {wanted}", hint="set unit"
        )
    return float(one.si / other.si)
