"""A plan before any data: sizes that scale as statistics say, what parameters imitate, and a file that holds."""

import pytest

from labrun.app.check import check
from labrun.app.next import plan_trials
from labrun.errors import RequestError, StoreError
from labrun.report.gap_text import trial_plan_text


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("plan")


@pytest.fixture(scope="module")
def plan(folder):
    return plan_trials(
        "hinge-pendulum", "hinge", noise={"angle": 2e-3}, out=folder / "plan.toml", workspace=folder
    )


def sizes(result):
    return {str(effect.name): effect.size.value for effect in result.visible if effect.size is not None}


def test_half_the_noise_and_a_quarter_of_the_repeats_show_the_same_sizes(plan, folder):
    other = plan_trials(
        "hinge-pendulum",
        "hinge",
        noise={"angle": 1e-3},
        repeats=12,
        out=folder / "other.toml",
        workspace=folder,
    )
    mine, theirs = sizes(plan), sizes(other)
    for name in ("rest-offset at hinge", "constant-force at hinge"):  # linear in their size
        assert theirs[name] == pytest.approx(0.25 * mine[name], rel=0.25)


def test_what_a_free_parameter_imitates_no_trial_can_show(plan):
    damping = next(effect for effect in plan.visible if effect.name.effect == "viscous-damping")
    assert damping.size is None
    assert "imitate" in damping.why


def test_effects_that_would_look_the_same_are_named_with_one_another(plan):
    friction = next(effect for effect in plan.visible if effect.name.effect == "coulomb-friction")
    assert "stribeck-friction at hinge" in map(str, friction.alike)
    assert 0 <= friction.best < len(plan.trials)


def test_the_experiment_that_is_written_stays_inside_the_limits(plan):
    planned = check(str(plan.file))
    planned.require_feasible()
    assert planned.trials == len(plan.trials) * plan.repeats
    assert all(abs(trial.condition["release"]) <= 90 for trial in plan.trials)


def test_the_words_name_trials_sizes_and_what_is_hidden(plan):
    text = trial_plan_text(plan)
    assert "not visible in any of them" in text
    assert "Coulomb friction at hinge" in text
    assert f"labrun run {plan.file}" in text
    assert plan.to_json()["noise"] == {"angle": 2e-3}


def test_bad_requests_are_told_before_anything_is_computed(folder, plan):
    with pytest.raises(RequestError, match="there already"):
        plan_trials("hinge-pendulum", "hinge", out=plan.file, workspace=folder)
    with pytest.raises(RequestError, match="positive size of an output") as refused:
        plan_trials("hinge-pendulum", "hinge", noise={"angel": 1.0}, out=folder / "x.toml", workspace=folder)
    assert "angle" in refused.value.hint


def test_a_folder_that_takes_no_file_is_told_before_anything_is_computed(folder, monkeypatch):
    def refused(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refused)
    notes = []
    with pytest.raises(StoreError, match="nothing was computed"):
        plan_trials("hinge-pendulum", "hinge", out=folder / "y.toml", workspace=folder, note=notes.append)
    assert notes == []
