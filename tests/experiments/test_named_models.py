"""The model that an experiment names in [gap] is what its dry run simulates, but for what the dry run hides."""

from collections import defaultdict

import numpy as np
import pytest

from labrun.app.run import run as execute
from labrun.blind import named_model
from labrun.experiment import load_named
from labrun.fit.dataset import load_dataset
from labrun.fit.output_error import fit_model

SMALLER = {
    "hinge": ("run.conditions=[{release=20},{release=45}]", "trial.repeats=4"),
    "fin-step": ("trial.repeats=4", "trial.duration_s=16"),
    "driven-joint": ("trial.repeats=4",),
    "driven-joint-bushing": ("trial.repeats=4",),
    "tail-sweep": (
        "sweep.axes={alpha=[20,50],beta=[0],f=[0.6,1.4],v=[0.1],pose=[0]}",
        "leaders={count=1,repeats=2}",
    ),
    "hinge-life": (
        "run.conditions=[{layup='polyester',specimen=1,range=120},{layup='sandwich',specimen=1,range=120}]",
        "trial.until.max_cycles=101",
        "by_hand.mountings=3",
    ),
    "hinge-tensile": (
        "run.conditions=[{layup='polyester',specimen=1},{layup='sandwich',specimen=1}]",
        "by_hand.mountings=3",
    ),
}
LONG = ("fin-step", "tail-sweep", "driven-joint-bushing", "driven-joint", "hinge-tensile")
"""What takes long; the bushing is on the bench of the driven joint."""
STRONG = {
    "hinge": "coulomb-friction@hinge:torque=4e-4",
    "fin-step": "cross-talk@torque_x:share=-0.3",
    "driven-joint": "coulomb-friction@hinge:torque=5e-3",
    "driven-joint-bushing": "tilt=0.05",
    "tail-sweep": "lag@torque_z:time_constant=0.05",
    "hinge-life": "cubic-stiffness@hinge",
    "hinge-tensile": "saturation@force:level=110",
}
AGREES = 0.45
"""Bound of the systematic part of the residual, in units of one trial's noise."""


def systematic(name, hide, folder):
    """Return what the fitted model leaves in all repeats alike, each output in units of one trial's noise."""
    loaded = load_named(name, folder, SMALLER[name])
    model = named_model(loaded)
    run = execute(loaded, results=folder, dry_run=True, seed=3, draw=False, hide=[hide]).run
    data = load_dataset(run, model, loaded.experiment.gap.signals)
    fitted = fit_model(model, data, rng=np.random.default_rng(0), starts=1)
    residuals = defaultdict(list)
    for trial, simulated in zip(data.trials, fitted.simulated, strict=True):
        residuals[tuple(trial.condition.items())].append((trial.time_s, trial.outputs - simulated))
    shared, scatter = [], []
    for repeats in residuals.values():
        count = min(len(time_s) for time_s, _ in repeats)
        base = repeats[0][0][:count]
        aligned = np.array(
            [
                np.column_stack([np.interp(base, time_s, column) for column in residual.T])
                for time_s, residual in repeats
            ]
        )
        variance = aligned.var(axis=0, ddof=1)
        shared.append((aligned.mean(axis=0) ** 2 - variance / len(repeats)).mean(axis=0))
        scatter.append(variance.mean(axis=0))
    return np.sqrt(np.maximum(np.mean(shared, axis=0), 0.0) / np.mean(scatter, axis=0))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in LONG else []) for name in SMALLER]
)
def test_with_nothing_hidden_the_named_model_agrees_within_noise_and_with_an_effect_it_does_not(
    name, tmp_path
):
    nothing = float(np.sqrt(np.mean(systematic(name, "none", tmp_path) ** 2)))
    hidden = float(systematic(name, STRONG[name], tmp_path).max())
    print(f"{name}: {nothing:.2f} with nothing hidden, {hidden:.2f} with {STRONG[name]}")
    assert nothing < AGREES
    assert hidden > 1.0
    assert hidden > 4 * nothing


@pytest.mark.parametrize("name", SMALLER)
def test_the_signals_of_the_named_model_are_all_told(name, tmp_path):
    loaded = load_named(name, tmp_path, [])
    model = named_model(loaded)
    ports = {port.name for port in (*model.inputs, *model.outputs)}
    assert set(loaded.experiment.gap.signals) == ports
