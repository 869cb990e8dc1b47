"""The leaders of one experiment's run are the conditions of another."""

from pathlib import Path

import pytest

import labrun
from labrun.app.leaders import leaders_of
from labrun.errors import RequestError, SpecError
from labrun.experiment import condition_key, load_experiment
from labrun.runner import SilentProgress
from labrun.store import open_run

LAB = """
title = "Thrust in the laboratory"
kind = "sweep"
[rig]
scene = "caudal-tank"
[rig.devices.tail]
plugin = "arduino-servo"
port = "/dev/ttyACM0"
limits = { angle_deg = [-60, 60], speed_deg_s = 528 }
[rig.devices.wrench]
plugin = "robotiq-ft300"
port = "/dev/ttyUSB0"
limits = { force_n = 300, torque_n_m = 30 }
[gait]
plugin = "sine"
joints.tail = { amplitude_deg = "a", frequency_hz = "f" }
[trial]
cycles = 2
repeats = 2
[objectives.thrust]
plugin = "cycle-mean"
channel = "wrench.force_x"
goal = "maximise"
[leaders]
count = 3
repeats = 2
"""


class Notes(SilentProgress):
    """Keeps what is told."""

    def __init__(self):
        self.texts = []

    def note(self, text):
        self.texts.append(text)


SWEEP = "[sweep]\naxes = { a = [20, 30, 40, 50], f = [1.2] }\n"
FIELD = LAB.replace('kind = "sweep"', 'kind = "run"').replace('goal = "maximise"\n', "") + (
    '[run]\nconditions = { leaders_of = "lab", count = 4 }\n[run.over]\nfin = ["large", "small"]\n'
)


@pytest.fixture
def bench(tmp_path):
    folder = tmp_path / "experiments"
    folder.mkdir()
    (folder / "lab.toml").write_text(LAB + SWEEP)
    (folder / "field.toml").write_text(FIELD)

    def run(name, **keys):
        return labrun.run(
            folder / f"{name}.toml",
            dry_run=True,
            seed=1,
            results=tmp_path / "results",
            workspace=tmp_path,
            **keys,
        )

    return run


def check(tmp_path, name="field"):
    return labrun.check(
        tmp_path / "experiments" / f"{name}.toml", results=tmp_path / "results", workspace=tmp_path
    )


def test_leaders_are_numbered_best_first_and_the_run_is_named_in_the_stored_file(bench, tmp_path):
    lab = bench("lab")
    field = bench("field")
    stored = load_experiment(field.run / "spec.toml").experiment
    assert [source.model_dump() for source in stored.run.taken_from] == [
        {"experiment": "lab", "run": lab.run.name}
    ]
    assert [condition["gait"] for condition in stored.run.conditions] == [1, 2, 3, 4]
    with open_run(lab.run) as opened:
        fresh = {}
        for outcome in opened.outcomes:
            if outcome.role == "fresh":
                fresh.setdefault(outcome.condition["a"], []).append(outcome.objectives["thrust"])
    by_fresh = sorted(fresh, key=lambda a: -sum(fresh[a]))
    assert [condition["a"] for condition in stored.run.conditions][:3] == by_fresh
    with open_run(field.run) as opened:
        measured = {condition_key(outcome.condition) for outcome in opened.outcomes}
    assert len(measured) == 4 * 2


def test_a_plan_is_checked_before_there_is_a_run(bench, tmp_path):
    with pytest.raises(RequestError, match="which has no run in"):
        bench("field")
    assert check(tmp_path).trials == 4 * 2 * 2


def test_a_resumed_run_keeps_the_leaders_it_began_with(bench):
    bench("lab")
    whole = bench("field")
    part = bench("field", limit=5)
    newer = bench("lab", overrides=["sweep.axes.a=[10,15,25,35]"])
    assert newer.finished
    ended = labrun.resume(part.run)
    with open_run(ended.run) as run, open_run(whole.run) as other:
        assert [o.condition for o in run.outcomes] == [o.condition for o in other.outcomes]
        assert [o.objectives for o in run.outcomes] == [o.objectives for o in other.outcomes]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda text: text.replace("count = 4", "count = 5"), "has 4 conditions .* 5 leaders are required"),
        (lambda text: text.replace('plugin = "sine"', 'plugin = "formula"').replace(
            'amplitude_deg = "a", frequency_hz = "f"', 'angle_deg = "a * sin(f * t)"').replace(
            "cycles = 2", "duration_s = 2").replace('"cycle-mean"', '"mean"'), "is of another rig"),
    ],
)  # fmt: skip
def test_leaders_that_will_not_do_are_told_before_anything_moves(bench, tmp_path, change, problem):
    bench("lab")
    path = tmp_path / "experiments" / "field.toml"
    path.write_text(change(path.read_text()))
    with pytest.raises(RequestError, match=problem):
        bench("field")
    assert not (tmp_path / "results" / "field").exists()


def test_a_run_that_did_not_finish_has_no_leaders(bench):
    part = bench("lab", limit=3)
    with pytest.raises(RequestError, match="has not finished"):
        leaders_of(part.run, 2)


def test_an_experiment_that_is_not_there_is_told_at_its_place(tmp_path, bench):
    path = tmp_path / "experiments" / "field.toml"
    path.write_text(FIELD.replace('"lab"', '"labb"'))
    with pytest.raises(SpecError, match=r"field.toml:\d+:\d+: run.conditions.leaders_of") as raises:
        load_experiment(Path(path))
    assert "unknown name" not in str(raises.value)  # what follows from it is not told as well


def test_an_experiment_that_varies_something_else_altogether_is_told_at_its_place(tmp_path, bench):
    path = tmp_path / "experiments" / "field.toml"
    path.write_text(FIELD.replace('frequency_hz = "f"', 'frequency_hz = "g"').replace('"a"', '"b"'))
    with pytest.raises(
        SpecError,
        match=r"field.toml:\d+:\d+: run.conditions.leaders_of = .* names a, f; the gait here uses b, g",
    ) as raises:
        load_experiment(Path(path))
    assert "unknown name" not in str(raises.value)


BESIDE = LAB.replace("count = 3", 'count = 3\nbeside = { leaders_of = "lab", count = 2 }') + (
    "[sweep]\naxes = { a = [22, 33], f = [1.2] }\n"
)


def test_leaders_of_another_run_are_measured_among_ones_own(bench, tmp_path):
    lab = bench("lab")
    (tmp_path / "experiments" / "current.toml").write_text(BESIDE)
    assert check(tmp_path, "current").trials == 2 * 2 + (2 + 2 + 1) * 2
    current = bench("current")
    guests = [leader["a"] for leader in leaders_of(lab.run, 2)]
    with open_run(current.run) as opened:
        fresh = [outcome.condition["a"] for outcome in opened.outcomes if outcome.role == "fresh"]
    assert sorted(fresh) == sorted(2 * [22, 33, *guests])
    stored = load_experiment(current.run / "spec.toml").experiment
    assert [hidden.run for hidden in stored.leaders.taken_from] == [lab.run.name]
    ranked = labrun.rank(
        ["lab", "current"], str(bench("field").run), objective="thrust", results=tmp_path / "results"
    )
    assert sum(value is not None for value in ranked.laboratory_values[str(current.run)]) == 2


def test_a_run_goes_without_the_others_leaders_where_there_are_none_and_says_so(bench, tmp_path):
    (tmp_path / "experiments" / "current.toml").write_text(BESIDE)
    notes = Notes()
    bench("current", progress=notes)
    assert any("no run of lab" in text for text in notes.texts)


def test_leaders_that_vary_something_else_cannot_stand_beside(bench, tmp_path):
    path = tmp_path / "experiments" / "current.toml"
    path.write_text(BESIDE.replace("a = [22, 33], f = [1.2]", "a = [22, 33]").replace('= "f"', "= 1.2"))
    with pytest.raises(
        SpecError,
        match=r"current.toml:\d+:\d+: leaders.beside.leaders_of = .* have the names a, f; those here a;",
    ):
        load_experiment(path)
