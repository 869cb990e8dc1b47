"""From a dry run that hides something to the right verdict, on benches other than the hinge: as a person types it."""

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from labrun.cli.app import app

FIN_STEP = (
    "trial.repeats=3",
    # the step comes after 7 whole cycles instead of 14
    "trial.duration_s=9",
    'gait.let.a="where(t < 5, a_before, a_after)"',
    'gait.let.b="b_before + (b_after - b_before) * clip((t - 5) / 0.1, 0, 1)"',
    "run.conditions=[{a_before=0,a_after=40,b_before=0,b_after=0},{a_before=40,a_after=40,b_before=0,b_after=-20},"
    "{a_before=20,a_after=35,b_before=0,b_after=0}]",
)
TAIL_SWEEP = (
    "sweep.axes={alpha=[30,50],beta=[0],f=[0.8,1.2],v=[0.1],pose=[0]}",
    "sweep.where=[]",
    "trial.repeats=3",
    "leaders.count=1",
    "leaders.repeats=2",
    "trial.carriage.to_m=0.35",
)
Answer = tuple[dict[str, Any], dict[str, Any]]
"""What the diagnosis says, and what opening the seal does."""


@pytest.fixture(autouse=True)
def _in_a_fresh_workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    typed("init", ".")


def typed(*arguments: str) -> str:
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code == 0, done.output
    return str(done.stdout)


def found_on(experiment: str, hidden: str, overrides: tuple[str, ...] = (), seed: int = 5) -> Answer:
    sets = [word for override in overrides for word in ("--set", override)]
    typed("run", experiment, "--dry-run", "--seed", str(seed), "--hide", hidden, *sets)
    loads = json.loads(typed("gap", "diagnose", experiment, "--no-report", "--workers", "2", "--json"))
    return loads, json.loads(typed("gap", "reveal", experiment, "--json"))


def assert_named(answer: Answer, effect: str, site: str) -> None:
    """One cause, alone or beside one rival, is what was hidden; and the opened seal says so."""
    message, revealed = answer
    (cause,) = message["causes"]
    named = [
        (named_cause["effect"], named_cause["site"])
        for named_cause in (cause, *cause["indistinguishable_from"])
    ]
    assert (effect, site) in named
    assert len(named) <= 2
    assert revealed["score"] == ("right" if named[0] == (effect, site) else "right, in a stated set")
    assert message["shrinkage"]["share_removed"]["value"] > 0.9


def assert_quiet(answer: Answer) -> None:
    message, revealed = answer
    assert message["verdict"] == "no-gap"
    assert message["causes"] == []
    assert revealed["score"] == "right"


@pytest.mark.slow
def test_a_late_command_of_the_fin_is_found_against_the_model_of_the_step_response() -> None:
    # a late command is late whichever wire it was late on: the model's own delay is as good a name for it
    assert_named(found_on("fin-step", "delay@tail:delay=0.05", FIN_STEP), "delay", "tail")


@pytest.mark.slow
def test_a_late_command_of_the_towed_tail_is_found_in_six_axes() -> None:
    answer = found_on("tail-sweep", "delay@tail:delay=0.03", TAIL_SWEEP)
    assert_named(answer, "delay", "tail")
    low, high = answer[0]["causes"][0]["values"]["delay"]["ci95"]
    assert low < 0.03 < high


@pytest.mark.slow
def test_a_fin_that_lacks_nothing_is_blamed_for_nothing() -> None:
    assert_quiet(found_on("fin-step", "none", FIN_STEP))


@pytest.mark.slow
def test_a_towed_tail_that_lacks_nothing_is_blamed_for_nothing() -> None:
    assert_quiet(found_on("tail-sweep", "none", TAIL_SWEEP))


@pytest.mark.slow
def test_a_late_command_is_found_in_the_whole_step_experiment() -> None:
    assert_named(found_on("fin-step", "delay@tail:delay=0.05"), "delay", "tail")


@pytest.mark.slow
def test_a_late_command_is_found_in_the_whole_sweep_of_the_tail() -> None:
    assert_named(found_on("tail-sweep", "delay@tail:delay=0.03"), "delay", "tail")
