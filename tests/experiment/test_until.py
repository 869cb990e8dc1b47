"""Conditions that end a trial: what they read, and what cannot be meant."""

import pytest

from labrun.errors import SpecError
from labrun.experiment import Criterion, loads_experiment
from labrun.toml import ExpressionError

FILE = """
title = "Life"
kind = "run"
[rig.devices.tail]
plugin = "arduino-servo"
port = "/dev/ttyACM0"
[gait]
plugin = "sine"
joints.tail = { amplitude_deg = "a", frequency_hz = 1 }
[trial]
until = { when = "peak < 0.2 * median(first 100)", max_cycles = 50000 }
[run]
conditions = [{ a = 10 }]
[objectives]
peak = { plugin = "pond:Peak" }
"""


def test_a_summary_is_of_the_objective_that_is_named_and_waits_for_its_cycles():
    criterion = Criterion.of("peak < 0.5 * median(first 3)", ["peak", "work"])
    assert not criterion.holds({"peak": [0.0, 0.0], "work": [1.0, 1.0]})
    assert criterion.holds({"peak": [9.0, 10.0, 11.0, 4.9], "work": [1.0] * 4})
    assert not criterion.holds({"peak": [9.0, 10.0, 11.0, 5.1], "work": [1.0] * 4})


def test_summaries_of_the_last_cycles_of_another_objective_and_the_number_of_cycles_can_be_used():
    criterion = Criterion.of("max(work, last 2) < 1 or cycle >= 5", ["peak", "work"])
    assert not criterion.holds({"work": [0.0, 2.0, 0.5]})
    assert criterion.holds({"work": [2.0, 0.9, 0.5]})
    assert criterion.holds({"work": [2.0] * 5})


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("peak", "is not a comparison"),
        ("median(first 3) < 1", "does not name its objective; write median(peak, first 3)"),
        ("peak < median(work, first 0)", "covers no cycle"),
        ("peak < median(first)", "is not a summary of cycles; write for example median(first 100)"),
        ("peak < open(3)", "unknown function"),
    ],
)
def test_what_is_no_condition_is_said(text, complaint):
    with pytest.raises(ExpressionError) as error:
        Criterion.of(text, ["peak", "work"])
    assert complaint in str(error.value)


@pytest.mark.parametrize(
    ("before", "after", "complaint"),
    [
        ('"peak < 0.2', '"peek < 0.2', 'no objective "peek"; did you mean "peak"?'),
        ("max_cycles = 50000", "max_cycles = 50", "and would never be judged"),
        ("[trial]", "[trial]\ncycles = 5", "the trial has another length already, cycles"),
        ("[trial]", "[trial]\ndiscard_cycles = 5", "a trial with until counts every cycle"),
        ("[trial]", '[trial]\non_fault = "skip"', "continues with the same cycles"),
        (
            "[objectives]",
            '[objectives]\ncycles = { plugin = "pond:Peak" }',
            "reserved for the number of cycles",
        ),
        ('"sine"', '"hold"', 'the gait "hold" has no cycle to count'),
    ],
)
def test_what_does_not_go_with_it_is_said(before, after, complaint):
    with pytest.raises(SpecError) as error:
        loads_experiment(FILE.replace(before, after), "life")
    assert complaint in str(error.value)
