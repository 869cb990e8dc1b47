"""The laboratory's order against the field's, and which gait to take."""

import json
import re

import pytest

import labrun
from labrun.errors import RequestError
from labrun.report.comparison import ranking_text

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
joints.tail = { amplitude_deg = "a", frequency_hz = 1.2 }
[trial]
cycles = 2
repeats = 2
tare = { duration_s = 1 }
[leaders]
count = 4
repeats = 2
[sweep]
axes = { a = [20, 30, 40, 50] }
[objectives.thrust]
plugin = "cycle-mean"
channel = "wrench.force_x"
goal = "maximise"
"""
FIELD = (
    LAB.partition("[sweep]")[0].replace('"sweep"', '"run"')
    + """
[run]
conditions = { leaders_of = "lab", count = 4 }
[run.over]
water = ["tank", "pool"]
[objectives.turning]
plugin = "asked"
question = "Seconds"
least = 1
most = 99
value = "360 / answer"
unit = "deg/s"
"""
)


@pytest.fixture
def bench(tmp_path):
    """Return a function that measures lab and field, and ranks: gait number -> seconds in the field."""
    (tmp_path / "lab.toml").write_text(LAB)
    (tmp_path / "field.toml").write_text(FIELD)
    results = tmp_path / "results"
    labrun.run(tmp_path / "lab.toml", dry_run=True, seed=1, results=results)

    def ranked(seconds, **keys):
        count = iter(range(1000))

        def person(text):
            if "Enter" in text:
                return ""
            gait = int(re.search(r"gait = (\d)", text)[1])
            return str(seconds(gait) * (1 + 0.001 * (next(count) % 5)))

        labrun.run(tmp_path / "field.toml", dry_run=True, seed=1, results=results, person=person, **keys)
        return labrun.rank(["lab"], "field", results=results)

    return ranked


def test_an_order_that_holds_names_the_best_gait_and_says_why(bench, tmp_path):
    result = bench(lambda gait: 10.0 * gait)
    assert result.name(result.winner) == "gait 1"
    for column in result.columns:
        (agreed,) = column.agreements.values()
        assert agreed.tau == pytest.approx(1.0)
        assert agreed.tau_p == pytest.approx(2 / 24)
    text = ranking_text(result)
    assert "take gait 1: in its worst setting (water = " in text
    assert "exact p" in text
    (stored,) = (tmp_path / "results" / "field").glob("*/ranking.json")
    assert json.loads(stored.read_text())["winner"] == "gait 1"
    named = labrun.rank(["lab"], "field", objective="turning", results=tmp_path / "results")
    assert named.winner == result.winner
    with pytest.raises(RequestError, match="no objective 'turn'"):
        labrun.rank(["lab"], "field", objective="turn", results=tmp_path / "results")


def test_an_order_that_does_not_hold_says_so(bench):
    result = bench(lambda gait: {1: 30.0, 2: 10.0, 3: 20.0, 4: 15.0}[gait])
    assert result.name(result.winner) == "gait 2"
    assert "the laboratory's order does not carry over to water = pool" in ranking_text(result)


def test_a_laboratory_that_measured_other_gaits_is_told(bench, tmp_path):
    bench(lambda gait: 10.0 * gait)
    path = tmp_path / "other.toml"
    path.write_text(LAB.replace("[20, 30, 40, 50]", "[15, 25]"))
    labrun.run(path, dry_run=True, seed=1, results=tmp_path / "results")
    result = labrun.rank(["lab", "other"], "field", results=tmp_path / "results")
    assert any("measured none of the 4 gaits" in note for note in result.notes)
    assert "no order to compare" in ranking_text(result)


def test_a_field_without_a_trial_that_counts_is_refused(bench, tmp_path):
    with pytest.raises(RequestError, match="no accepted trial"):
        bench(lambda gait: 10.0, limit=0)
