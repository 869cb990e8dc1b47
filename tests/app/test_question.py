"""What a diagnosis is asked: which trials are repeats, as the experiment says."""

import pytest

import labrun
from labrun.app.question import ask
from labrun.errors import RequestError, SpecError
from labrun.experiment import loads_experiment, shipped_experiments

STRIPS = ("run.conditions=[{specimen=1},{specimen=2},{specimen=3}]",)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return labrun.run(
        "polyester-tensile", dry_run=True, seed=1, overrides=STRIPS, results=tmp_path_factory.mktemp("runs")
    ).run


def test_conditions_that_the_experiment_calls_repeats_are_not_told_apart(run):
    trials = ask(run, None).dataset.trials
    assert [dict(trial.condition) for trial in trials] == [{}, {}, {}]


def test_a_model_that_tells_repeats_apart_is_refused(run, tmp_path):
    model = tmp_path / "worn.toml"
    model.write_text(
        'name = "worn"\nstates = []\ninputs = ["displacement"]\n[parameters]\nk = 1.0\n'
        '[outputs]\nforce = "k*specimen*displacement"\n'
    )
    with pytest.raises(RequestError, match="worn tells specimen apart"):
        ask(run, model)


def test_repeats_of_a_misspelt_condition_are_named():
    text = (shipped_experiments() / "polyester-tensile.toml").read_text(encoding="utf-8")
    text = text.replace('repeats = ["specimen"]', 'repeats = ["speciman"]')
    with pytest.raises(SpecError, match='did you mean "specimen"'):
        loads_experiment(text, "polyester-tensile")
