"""Which trials of a rig are thought of at all: inside its limits, and as far as they let one go."""

import numpy as np
import pytest

from labrun.app.run import run as execute
from labrun.blind import named_model
from labrun.experiment import load_named
from labrun.fit.dataset import load_dataset
from labrun.gap.next.run_bench import RunBench
from labrun.runner import Planner
from labrun.store import open_run


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    loaded = load_named("driven-joint", folder, ["trial.repeats=1", "trial.duration_s=2"])
    run = execute(loaded, results=folder, dry_run=True, seed=1, draw=False, hide=["none"]).run
    model, signals = named_model(loaded), loaded.experiment.gap.signals
    return RunBench.of(open_run(run), load_dataset(run, model, signals), model, signals, 3)


@pytest.fixture(scope="module")
def pool(bench):
    return bench.pool(np.random.default_rng(0))


def test_every_trial_stays_inside_the_limits(bench, pool):
    planner = Planner(bench.experiment)
    assert len(pool) > 20
    assert not any(planner.excess_of(trial.condition) for trial in pool)


def test_a_speed_limit_lets_small_motion_be_faster_than_large_motion(pool):
    """At 30 deg, 250 deg/s allow 1.3 Hz; at a quarter of it, four times that."""
    fastest = max(trial.condition["f"] for trial in pool)
    assert fastest > 4.0
    assert max(trial.condition["f"] for trial in pool if abs(trial.condition["amplitude"]) >= 30.0) < 1.4


def test_no_frequency_is_below_zero_but_amplitudes_are(pool):
    assert all(trial.condition["f"] > 0 for trial in pool)
    assert any(trial.condition["amplitude"] < 0 for trial in pool)


def test_a_person_turns_the_bench_and_changes_masses_and_strips(bench, pool):
    assert set(bench.set_by_hand) == {"payload_g", "strip_mm", "up"}
    for name, values in {"payload_g": {20, 60, 80}, "strip_mm": {12.5, 37.5, 50}, "up": {-1}}.items():
        assert {trial.condition[name] for trial in pool} - {40, 25, 1} == values


def test_what_somebody_sets_anew_costs_a_minute_each_time(pool):
    def cost(changes):
        return [
            trial.cost_s
            for trial in pool
            if sum(trial.condition[k] != v for k, v in {"payload_g": 40, "strip_mm": 25, "up": 1}.items())
            == changes
        ]

    assert min(cost(1)) - min(cost(0)) == pytest.approx(3 * 60.0, rel=0.05)
    assert min(cost(2)) - min(cost(0)) == pytest.approx(6 * 60.0, rel=0.05)
