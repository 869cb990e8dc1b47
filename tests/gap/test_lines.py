"""Forces that come back along a coordinate: found over many turns, and in wells that no simulation comes back from."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labrun.fit.dataset import Dataset, FitTrial
from labrun.gap import Options, diagnose_dataset
from labrun.gap.averaging import averaged
from labrun.gap.candidates import Candidate, candidates, site_scales
from labrun.gap.lines import growth_in_wells, line_starts
from labrun.gap.recalibration import Recalibrated, recalibrate
from labrun.models import Model, parse_model
from labrun.store import SignalInfo

KNOB = """
name = "knob"
states = ["angle", "rate"]
inputs = ["torque"]
[parameters]
inertia = { value = 3.0e-4, tolerance = 0.05, unit = "kg m^2" }
damping = { value = 8e-4, tolerance = "free", unit = "N m s/rad", lower = 0.0 }
[equations]
angle = "rate"
rate  = "(torque + force.shaft - damping*rate) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.shaft]
kind = "joint"
coordinate = "angle"
rate = "rate"
[initial]
angle = "first"
rate = 0.0
"""
PERIODS, SIZE, PHASE = 24.0, 1.5e-3, 0.9
MOTIONS: tuple[tuple[str, Callable[[float], float]], ...] = (
    ("slow turn", lambda t: 0.9 * t),
    ("turn", lambda t: 2.5 * t),
    ("fast turn", lambda t: 5.0 * t),
    ("there and back", lambda t: 1.5 * np.sin(2 * np.pi * 0.4 * t)),
)


def cogs(angle: float, rate: float) -> float:
    """Return the torque of 24 slots."""
    return SIZE * float(np.sin(PERIODS * angle + PHASE))


def rubs(angle: float, rate: float) -> float:
    """Return dry friction of the same size."""
    return SIZE * float(np.tanh(rate / 0.02))


def turned(*missing: Callable[[float, float], float]) -> Dataset:
    """Return four motions under position control, whose torque alone is recorded beside the angle."""
    rng, trials = np.random.default_rng(4), []
    time_s = np.arange(0.0, 4.0, 0.008)
    for name, motion in MOTIONS:
        x, torques, states = np.array([0.1, 0.0]), [], []
        for t in time_s:  # the controller holds its torque from sample to sample
            torque = 0.3 * (0.1 + motion(t) - x[0]) + 0.012 * ((motion(t + 1e-3) - motion(t)) / 1e-3 - x[1])
            states.append(x[0])
            torques.append(torque)

            def slope(_: float, y: np.ndarray, torque: float = torque) -> list[float]:
                lost = sum(force(y[0], y[1]) for force in missing)
                return [y[1], (torque - 6.5e-4 * y[1] - lost) / 3.1e-4]

            x = solve_ivp(slope, (0.0, 0.008), x, rtol=1e-8, atol=1e-10).y[:, -1]
        outputs = (np.array(states) + rng.normal(0.0, 2e-4, len(time_s)))[:, None]
        trials.append(FitTrial(name, {"motion": name}, 1, time_s, np.array(torques)[:, None], outputs))
    torque, angle = (SignalInfo("torque", "N m", "hold"),), (SignalInfo("angle", "rad", "linear"),)
    return Dataset("knob", Path("knob"), "recording", torque, angle, tuple(trials))


def knob() -> Model:
    return parse_model(KNOB, "knob.toml")


def looked_at(data: Dataset) -> tuple[Recalibrated, Candidate]:
    """Return the recalibrated model of a knob, and cogging as a candidate of it."""
    recalibrated = recalibrate(knob(), averaged(data, knob()), np.random.default_rng(0), lambda _: None)
    every = candidates(recalibrated.problem.model, site_scales(recalibrated.problem, recalibrated.z))
    return recalibrated, next(candidate for candidate in every if candidate.name.effect == "cogging")


def test_the_periods_over_many_turns_are_read_from_what_is_missing() -> None:
    recalibrated, cogging = looked_at(turned(cogs))
    assert cogging.scale is not None
    (periods, sine, cosine), *_ = line_starts(recalibrated.problem, recalibrated.z, cogging)
    travel = 2.0 * cogging.scale.travel  # a line is as wide as one period more over the whole of it
    assert periods * cogging.scale.of("per-coordinate") == pytest.approx(PERIODS, abs=np.pi / travel)
    expected = SIZE * np.array([np.cos(PHASE), np.sin(PHASE)])
    assert np.array([sine, cosine]) * cogging.scale.force == pytest.approx(expected, abs=0.3 * SIZE)


def test_only_what_comes_back_along_the_way_makes_wells() -> None:
    recalibrated, cogging = looked_at(turned(cogs))
    growth = growth_in_wells(recalibrated.problem, recalibrated.z, cogging)
    assert growth == pytest.approx(np.sqrt(SIZE * PERIODS / 3.1e-4), rel=0.2)
    recalibrated, cogging = looked_at(turned(rubs))
    assert growth_in_wells(recalibrated.problem, recalibrated.z, cogging) == 0.0


@pytest.mark.slow
def test_a_knob_that_cogs_and_rubs_is_said_to_do_both() -> None:
    dataset = diagnose_dataset(turned(cogs, rubs), knob(), Options(places=False))
    causes = {str(cause.name): cause.values for cause in dataset.causes}
    assert set(causes) == {"cogging at shaft", "coulomb-friction at shaft"}
    assert causes["cogging at shaft"]["periods"].value == pytest.approx(PERIODS, rel=0.02)
    assert causes["coulomb-friction at shaft"]["torque"].value == pytest.approx(SIZE, rel=0.15)
    assert any("wells" in limitation for limitation in dataset.limitations)
