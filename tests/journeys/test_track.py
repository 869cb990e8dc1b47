"""Closed loops as a person runs them, and the verdict of the source's chapter 5 on its controllers."""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from labrun.search import t_interval
from labrun.store import open_run

SHORT = ("--set", "trial.duration_s=6", "--set", "trial.repeats=1", "--set", "objectives.first_cycle.to_s=3",
         "--set", "objectives.later.from_s=3", "--set", "objectives.later.to_s=6")  # fmt: skip
ALL_P = ("P-100", "P-109", "P-120")


@pytest.fixture(
    scope="module",
    params=[pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3)],
)
def errors(request, tmp_path_factory):
    """Return every accepted value of each objective by controller, of one whole dry run."""
    from labrun.app.run import run as execute
    from labrun.experiment import load_experiment, shipped_experiments

    loaded = load_experiment(shipped_experiments() / "force-control.toml")
    results = tmp_path_factory.mktemp("results")
    result = execute(loaded, results=results, dry_run=True, seed=request.param, draw=False)
    values: dict[str, dict[str, list[float]]] = {}
    with open_run(result.run) as run:
        for outcome in run.outcomes:
            assert outcome.status == "done", outcome.reason
            for name, value in outcome.objectives.items():
                values.setdefault(name, {}).setdefault(str(outcome.condition["controller"]), []).append(value)
    return values


def low(values):
    """Return the lower end of the mean's 95 % interval over repeats."""
    return t_interval(np.array(values))[0]


def below(smaller, larger, factor=1.0):
    """Tell whether one mean is below a share of another, with 95 % confidence (Welch's interval of the difference)."""
    difference = stats.ttest_ind(np.array(smaller), factor * np.array(larger), equal_var=False)
    return difference.confidence_interval(0.95).high < 0


def test_p_leaves_a_large_error_at_all_gains(errors):
    """Loop gain 1, so about half of the reference; its mean is 0.35 N."""
    for controller in ALL_P:
        assert low(errors["first_cycle"][controller]) > 0.12
        assert low(errors["later"][controller]) > 0.12
        assert low(errors["bias"][controller]) > 0.12


def test_pi_misses_the_first_cycle_and_follows_afterwards(errors):
    assert below(errors["first_cycle"]["FF-PI"], errors["first_cycle"]["PI"], 0.6)
    assert below(errors["later"]["PI"], errors["first_cycle"]["PI"], 0.7)
    assert all(below(errors["later"]["PI"], errors["later"][name], 0.6) for name in ALL_P)


def test_ff_p_is_acceptable_and_slightly_low(errors):
    assert low(errors["bias"]["FF-P"]) > 0.02
    for cycle in ("first_cycle", "later"):
        assert all(below(errors[cycle]["FF-P"], errors[cycle][name], 0.5) for name in ALL_P)


def test_ff_pi_follows_from_the_first_cycle_and_is_the_best(errors):
    others = [name for name in errors["later"] if name != "FF-PI"]
    for cycle in ("first_cycle", "later"):
        means = {name: np.mean(errors[cycle][name]) for name in errors[cycle]}
        assert min(means, key=means.get) == "FF-PI"
    assert all(below(errors["later"]["FF-PI"], errors["later"][name]) for name in others)
    assert below(errors["bias"]["FF-PI"], errors["bias"]["FF-P"])


def test_track_runs_shows_exports_and_draws_its_loops(labrun, tmp_path):
    done = labrun("track", "force-control", "--dry-run", "--seed", "1", "--json", *SHORT)
    assert done.code == 0, done.err
    run = Path(done.json["run"])
    with open_run(tmp_path / run) as stored:
        loop = stored.signals(0)["loop"]
        assert loop.rate_hz == 20
        assert len(loop.time_s) == 120
        assert stored.command(0).time_s[-1] == pytest.approx(6.0)
    assert "loop" in labrun("show", run).out
    assert labrun("export", run, "--to", "netcdf", "--output", "run.nc").code == 0
    assert labrun("report", run).code == 0


def test_a_track_that_was_stopped_goes_on_to_the_same_samples(labrun, tmp_path):
    arguments = ("track", "force-control", "--dry-run", "--seed", "5", *SHORT)
    whole = labrun(*arguments, "--results", "whole", "--json").json
    parted = labrun(*arguments, "--results", "parted", "--limit", "2", "--json").json
    for _ in range(2):
        resumed = labrun("resume", parted["run"], "--limit", "2", "--json")
        assert resumed.code == 0, resumed.err
    with open_run(tmp_path / whole["run"]) as first, open_run(tmp_path / parted["run"]) as second:
        assert len(first.outcomes) == len(second.outcomes) == 6
        for trial, resumed_trial in zip(first.outcomes, second.outcomes, strict=True):
            assert trial.condition == resumed_trial.condition
            assert trial.objectives == resumed_trial.objectives
            np.testing.assert_array_equal(
                first.signals(trial.index)["loop"].values, second.signals(trial.index)["loop"].values
            )


def test_the_plan_is_checked_for_the_worst_that_the_loops_may_do(labrun):
    assert "at most 522.4 deg/s (limit 528)" in labrun("check", "force-control").out
    refused = labrun("track", "force-control", "--dry-run", "--set", "track.loops.force.range=[20, 61]")
    assert refused.code == 2
    assert "worst angle of tail 61 deg is above the limit of 60 deg" in refused.err
    assert "narrow the range of the loop" in refused.err


def test_what_only_the_devices_or_a_condition_can_tell_is_said_before_anything_is_written(labrun, tmp_path):
    feedback = "track.loops.force.feedback.unit=deg"
    wrong_unit = labrun("track", "force-control", "--dry-run", "--set", feedback)
    assert wrong_unit.code == 2
    assert "which comes in N" in wrong_unit.err
    gain = "track.loops.force.controllers.PI.tracking_s='0 - 1'"
    wrong_value = labrun("track", "force-control", "--dry-run", "--set", gain)
    assert wrong_value.code == 2
    assert "controller = PI: controller PI of loop force: tracking_s" in wrong_value.err
    assert not (tmp_path / "results").exists()


def test_each_command_sends_to_the_one_that_fits(labrun):
    wrong = labrun("track", "hinge", "--dry-run")
    assert wrong.code == 2
    assert "labrun run hinge" in wrong.err
    again = labrun("sweep", "force-control", "--dry-run")
    assert again.code == 2
    assert "labrun track force-control" in again.err


def test_a_fitted_model_file_beside_the_experiment_is_used_and_stored(labrun, tmp_path):
    text = labrun("init", ".").code
    assert text == 0
    path = tmp_path / "experiments" / "force-control.toml"
    inline = "model = { gain = 0.00912, lag_s = 0.34, dead_s = 0.28 }"
    assert inline in path.read_text()
    path.write_text(path.read_text().replace(inline, 'model = "fopdt.toml"'))
    missing = labrun("check", "force-control")
    assert missing.code == 2
    assert 'cannot find the file "fopdt.toml"' in missing.err
    (path.parent / "fopdt.toml").write_text("gain = 0.008\nlag_s = 0.3\ndead_s = 0.25\n")
    done = labrun("track", "force-control", "--dry-run", "--seed", "1", "--limit", "1", "--json", *SHORT)
    assert done.code == 0, done.err
    assert "gain = 0.008" in (tmp_path / done.json["run"] / "spec.toml").read_text()
