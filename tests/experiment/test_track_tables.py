"""Closed-loop experiment files: what loads, and what is said about one that does not."""

import re

import pytest

from labrun.errors import SpecError
from labrun.experiment import load_experiment, loads_experiment
from labrun.toml import LocatedFault

GOOD = """\
title = "Thrust follows a wave"
kind  = "track"
[rig]
scene = "caudal-tank"
[rig.devices.tail]
plugin = "arduino-servo"
port   = "/dev/ttyACM0"
limits = { angle_deg = [-60, 60], speed_deg_s = 528 }
[rig.devices.wrench]
plugin = "robotiq-ft300"
port   = "/dev/ttyUSB0"
[gait]
plugin = "sine"
joints.tail = { amplitude_deg = "a", offset_deg = "b", frequency_hz = 1.4 }
[trial]
duration_s = 20
[track]
rate_hz = 20
conditions = [{ controller = "P", gain = 100 }, { controller = "FF", gain = 120 }]
[track.loops.force]
drives     = "a"
range      = [20, 59]
slew_per_s = 60
reference  = { plugin = "half-sine", low = 0.18, high = 0.45, period_s = 100 }
feedback   = { plugin = "cycle-average", channel = "wrench.torque_y", divide_by_m = 0.40, scale = -1 }
[track.loops.force.controllers]
P  = { plugin = "pid", p = "gain" }
FF = { plugin = "feedforward+pid", p = "gain / 10", model = { gain = 0.009 } }
[track.loops.side]
drives    = "b"
range     = [-1, 1]
reference = { plugin = "formula", value = "0.01 * sin(t)" }
feedback  = { plugin = "latest", channel = "wrench.force_y" }
controllers.I = { plugin = "pid", i = 2 }
[objectives.off]
plugin  = "mean-absolute"
channel = "loop.force_error"
[units]
a = "deg"
b = "deg"
"""


def load(tmp_path, *replacements):
    text = GOOD
    for old, new in replacements:
        assert old in text, old
        text = text.replace(old, new, 1)
    path = tmp_path / "wave.toml"
    path.write_text(text, encoding="utf-8")
    return load_experiment(path)


def test_a_file_with_two_loops_loads_and_its_resolved_text_is_equal(tmp_path):
    loaded = load(tmp_path)
    assert list(loaded.experiment.track.loops) == ["force", "side"]
    assert loaded.experiment.track.loops["force"].start == 20.0
    assert loaded.experiment.track.loops["side"].start == 0.0
    assert loads_experiment(loaded.resolved_toml, "wave").experiment == loaded.experiment


@pytest.mark.parametrize(
    ("old", "new", "index", "message"),
    [
        ('controller = "P"', 'controller = "PP"', "19:30", 'no loop has this controller; did you mean "P"'),
        ('controller = "P"', 'controller = "I"', "19:15", 'the loop force has no controller "I"'),
        ("[20, 59]", "[59, 20]", "22:14", "59 is not below 20"),
        ("slew_per_s = 60\n", "slew_per_s = 60\ninitial = 3\n", "24:11", "3 is outside 20 ... 59"),
        (
            'drives     = "a"',
            'drives     = "aa"',
            "21:14",
            'the gait does not use this name; did you mean "a"',
        ),
        ('drives    = "b"', 'drives    = "a"', "30:13", "the loop force drives this already"),
        ('drives    = "b"', 'drives    = "gain"', "30:13", "the conditions set this value already"),
        ("frequency_hz = 1.4", 'frequency_hz = "1 + a / 60"', "14:71", "a loop cannot change this key"),
        ('"wrench.torque_y"', '"wrench.torqe_y"', "25:52", 'did you mean "wrench.torque_y"'),
        (
            '"wrench.torque_y"',
            '"wrist.torque_y"',
            "25:52",
            'unknown device "wrist"; did you mean "wrench.torque_y"',
        ),
        ("half-sine", "halfsine", "24:25", 'unknown reference plugin; did you mean "half-sine"'),
        ("cycle-average", "cycle-avg", "25:25", 'unknown feedback plugin; did you mean "cycle-average"'),
        ('plugin = "pid", p', 'plugin = "pidd", p', "27:17", 'unknown controller plugin; did you mean "pid"'),
        ("period_s = 100", "period_ms = 100", "24:63", "write period_s = 0.1"),
        ('"gain / 10"', '"gian / 10"', "28:40", 'unknown name "gian"; did you mean "gain"'),
        ('"0.01 * sin(t)"', '"0.01 * sin(time)"', "32:43", 'unknown name "time"'),
        ("{ gain = 0.009 }", '"models/fin.toml"', "28:61", 'cannot find the file "models/fin.toml"'),
        ("{ gain = 0.009 }", "{ lag_s = 3 }", "28:53", "a model needs its gain"),
        ("loop.force_error", "loop.force_eror", "37:11", 'did you mean "loop.force_error"'),
        ('plugin = "sine"', 'plugin = "release"', "13:10", "it can steer formula, hold, sine"),
        ("rate_hz = 20\n", "", "17:2", 'the key "rate_hz" is missing'),
        ("[rig.devices.wrench]", "[rig.devices.loop]", "9:2", "this name is reserved"),
    ],
)
def test_what_is_wrong_is_said_with_its_place_and_what_would_do(tmp_path, old, new, index, message):
    with pytest.raises(SpecError) as caught:
        load(tmp_path, (old, new))
    strs = [str(LocatedFault(**problem)) for problem in caught.value.details["problems"]]
    assert any(re.search(rf"wave\.toml:{index}: ", text) and message in text for text in strs), strs


def test_several_mistakes_are_reported_at_once(tmp_path):
    with pytest.raises(SpecError) as caught:
        load(
            tmp_path,
            ("[20, 59]", "[59, 20]"),
            ('controller = "FF"', 'controller = "FFF"'),
            ("half-sine", "halfsine"),
            ("loop.force_error", "loop.force_eror"),
        )
    assert len(caught.value.details["problems"]) == 4


def test_a_gait_without_a_cycle_has_nothing_to_average_over(tmp_path):
    hold = 'plugin = "hold"\njoints.tail = { angle_deg = "a + b" }'
    sine = 'plugin = "sine"\njoints.tail = { amplitude_deg = "a", offset_deg = "b", frequency_hz = 1.4 }'
    with pytest.raises(SpecError, match="no cycle to average over"):
        load(tmp_path, (sine, hold))
    assert load(tmp_path, (sine, hold), ('"cycle-average",', '"cycle-average", period_s = 0.7,'))


def test_a_model_file_becomes_part_of_the_experiment(tmp_path):
    (tmp_path / "fin.toml").write_text("gain = 0.0085\nlag_s = 0.3\ndead_s = 0.2\nnote = 'fitted'\n")
    loaded = load(tmp_path, ("{ gain = 0.009 }", '"fin.toml"'))
    (tmp_path / "fin.toml").unlink()
    stored = loads_experiment(loaded.resolved_toml, "wave").experiment
    model = stored.track.loops["force"].controllers["FF"].settings["model"]
    assert model == {"gain": 0.0085, "lag_s": 0.3, "dead_s": 0.2}


def test_a_kind_track_needs_its_table(tmp_path):
    text = GOOD.split("[track]", maxsplit=1)[0]
    with pytest.raises(SpecError, match=r"needs a table \[track\]; add it"):
        loads_experiment(text, "wave")
