"""A linkage with a loop is fitted and diagnosed as any model: swings of a four-bar by scipy, which is one pendulum."""

from pathlib import Path

import numpy as np
import pytest
from chains import PARALLELOGRAM
from scipy.integrate import solve_ivp

from labrun.fit.dataset import Dataset, FitTrial
from labrun.fit.output_error import fit_model
from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.models import parse_model
from labrun.store import SignalInfo

INERTIA = 2 * (3e-4 + 0.1 * 0.1**2) + 0.5 * 0.2**2
PULL = 9.81 * 0.2 * (0.5 + 2 * 0.1 / 2)
NOISE_RAD = 0.002
DAMPING = 0.012


def four_bar():
    text = PARALLELOGRAM.replace("[parameters]\n", 'conditions = ["start"]\n[parameters]\n', 1)
    text = text.replace("friction = { value = 0.0,", 'friction = { value = 0.004, tolerance = "free",')
    text = text.replace("left = 0.6", 'left = "start"')
    kept = text[: text.index("open = {")] + "\n" + text[text.index("[initial]") :]
    return parse_model(kept, "four-bar.toml")


def swings(starts, dry_n_m=0.0, repeats=1):
    """Return noisy trials of the one pendulum that the linkage is, let go from each angle."""
    rng = np.random.default_rng(1)
    time_s = np.arange(0.0, 4.0, 0.02)
    trials = []

    def slope(_, x):
        return [x[1], (-PULL * np.sin(x[0]) - DAMPING * x[1] - dry_n_m * np.tanh(x[1] / 0.01)) / INERTIA]

    for start in starts:
        clean = solve_ivp(
            slope, (0.0, 4.0), [start, 0.0], t_eval=time_s, rtol=1e-8, atol=1e-10, max_step=0.01
        ).y[0]
        nothing = np.empty((len(time_s), 0))
        for repeat in range(1, repeats + 1):
            seen = clean[:, None] + NOISE_RAD * rng.normal(size=(len(time_s), 1))
            trials.append(FitTrial(f"trial {len(trials)}", {"start": start}, repeat, time_s, nothing, seen))
    return Dataset("four-bar", Path("four-bar"), "recording", (), (SignalInfo("left", "rad"),), tuple(trials))


def test_a_fit_finds_the_damping_of_a_linkage():
    model = fit_model(four_bar(), swings((0.3, 0.7)), rng=np.random.default_rng(0), starts=1)
    assert model.parameters["friction"].value == pytest.approx(DAMPING, rel=0.03)
    assert model.rmse["left"] == pytest.approx(NOISE_RAD, rel=0.1)


@pytest.mark.slow
def test_dry_friction_in_a_linkage_is_named_at_one_of_its_hinges_which_all_turn_alike():
    data = swings((0.3, 0.6, 0.9), dry_n_m=0.01, repeats=2)
    dataset = diagnose_dataset(data, four_bar(), Options(places=False))
    (cause,) = dataset.causes
    assert dataset.verdict == "explained"
    assert cause.name.effect == "coulomb-friction"
    assert cause.values["torque"].value == pytest.approx(0.01, rel=0.1)
