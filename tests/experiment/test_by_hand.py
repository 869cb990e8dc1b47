"""What is set by hand, as a file says it: what the person is told, and what cannot be meant."""

import pytest

from labrun.app.check import whole_plan
from labrun.errors import PlanError, SpecError
from labrun.experiment import ByHand, loads_experiment

FILE = """
title = "Specimens"
kind = "sweep"
[rig.devices.cell]
plugin = "robotiq-ft300"
port = "/dev/ttyUSB0"
[by_hand]
names = ["specimen"]
ask = "Mount {specimen}"
[trial]
duration_s = 1
[sweep]
axes = { specimen = ["p1", "p2"], v = [1, 2] }
[objectives]
"""


def test_the_person_is_told_the_values():
    table = ByHand(names=["mass", "specimen"], ask="Hang {mass} on {specimen} {here}")
    values = table.values({"v": 1.0, "mass": 0.5, "specimen": "p1"})
    assert table.instruction(values, {"mass": "kg"}) == "Hang 0.5 kg on p1 {here}"
    assert ByHand(names=["mass"]).instruction({"mass": 0.5}, {}) == "Set mass = 0.5"


@pytest.mark.parametrize(
    ("before", "after", "complaint"),
    [
        (
            'names = ["specimen"]',
            'names = ["speciman"]',
            'no condition has this name; did you mean "specimen"?',
        ),
        ('names = ["specimen"]', 'names = ["specimen", "specimen"]', '"specimen" is listed twice'),
        ("{specimen}", "{fin}", "{fin} is not in by_hand.names"),
        ('["p1", "p2"]', '["p1", "p2", "p1"]', "p1 is named 2 times"),
        (
            "[trial]",
            "[trial]\nreference = { every = 5, condition = { specimen = 'p1', v = 1 } }",
            "would change what is mounted",
        ),
        (
            'kind = "sweep"',
            'kind = "run"\nrun.conditions = [{ specimen = "p1", v = 1 }, { specimen = "p1", v = 1 }]',
            "specimen = p1 is named twice with the same values, here and as number 1",
        ),
        ("[trial]", "[damage]\n[trial]", "needs when, broken, or both"),
        ("[trial]", "[damage]\nwhen = 'w > 1'\n[trial]", 'unknown name "w"'),
        ("[trial]", "[damage]\nwhen = 'v + 1'\n[trial]", "is not a comparison"),
        ("[trial]", "[damage]\nof = ['fin']\nwhen = 'v > 1'\n[trial]", "no condition has this name"),
    ],
)
def test_what_cannot_be_meant_is_said(before, after, complaint):
    assert loads_experiment(FILE, "specimens").experiment.by_hand.mountings == 1
    with pytest.raises(SpecError) as error:
        loads_experiment(FILE.replace(before, after), "specimens")
    assert complaint in str(error.value)


def test_what_would_damage_is_refused_unless_the_file_allows_it():
    damaging = FILE.replace("[trial]", "[damage]\nwhen = 'v > 1'\n[trial]")
    with pytest.raises(PlanError) as error:
        whole_plan(loads_experiment(damaging, "specimens"), 0, None)
    assert "2 of 4 conditions would damage what they are measured on (damage.when: v > 1)" in str(error.value)
    assert "allow_damage = true" in error.value.hint
    allowed = damaging.replace("[trial]", "allow_damage = true\n[trial]")
    assert any(
        "come last" in note for note in whole_plan(loads_experiment(allowed, "specimens"), 0, None).notes
    )


@pytest.mark.parametrize(
    ("conditions", "complaint"),
    [
        ('{ specimen = ["p1", "p2"], v = 1 }', "run.conditions: expected a list of tables [{ ... }, ...]"),
        (
            '{ leader_of = "lab" }',
            'run.conditions.leader_of = "lab": unknown key; did you mean "leaders_of"?',
        ),
        ("3", "run.conditions = 3: expected a list [...]"),
    ],
)
def test_conditions_that_are_no_list_are_one_mistake(conditions, complaint):
    sweep = '[sweep]\naxes = { specimen = ["p1", "p2"], v = [1, 2] }\n'
    given = FILE.replace(sweep, "").replace('kind = "sweep"', f'kind = "run"\nrun.conditions = {conditions}')
    with pytest.raises(SpecError) as error:
        loads_experiment(given, "specimens")
    (message,) = str(error.value).splitlines()
    assert complaint in message
