"""A model that carries effects simulates as the bare model with those effects given."""

import pickle

import numpy as np
import pytest
from equations import OSCILLATOR

from labrun.effects import load_effect
from labrun.errors import ModelError
from labrun.models import Stepper, load_model, parse_model, prepare, simulate, suggest_substeps

TIME_S = np.linspace(0.0, 2.0, 201)
TORQUE = np.sin(7.0 * TIME_S)[:, None]
START = [0.05, 0.0]

FRICTION = """
[[effects]]
effect = "coulomb-friction"
site   = "hinge"
values = { torque = 0.3 }

[[effects]]
effect = "delay"
site   = "torque"
kind   = "input"
values = { delay = 0.013 }

[[effects]]
effect = "viscoelastic-creep"
site   = "hinge"
[effects.values]
stiffness = 9.0
time_constant = 0.2
"""


def attached():
    return [
        load_effect("coulomb-friction").attach("hinge", torque=0.3),
        load_effect("delay", "input").attach("torque", delay=0.013),
        load_effect("viscoelastic-creep").attach("hinge", stiffness=9.0, time_constant=0.2),
    ]


def test_effects_of_a_file_act_as_if_they_were_given():
    bare = parse_model(OSCILLATOR, "o.toml")
    model = parse_model(OSCILLATOR + FRICTION, "o.toml")
    expected = simulate(bare, TIME_S, TORQUE, initial_state=START, effects=attached(), substeps=4)
    result = simulate(model, TIME_S, TORQUE, initial_state=START, substeps=4)
    assert result.finite
    np.testing.assert_array_equal(result.outputs, expected.outputs)
    assert (
        np.ptp(simulate(bare, TIME_S, TORQUE, initial_state=START).outputs[:, 0] - result.outputs[:, 0])
        > 1e-3
    )


def test_effects_that_are_given_come_on_top_of_those_carried():
    bare = parse_model(OSCILLATOR, "o.toml")
    first, *others = attached()
    both = simulate(
        bare.with_effects([first]), TIME_S, TORQUE, initial_state=START, effects=others, substeps=4
    )
    all_given = simulate(bare, TIME_S, TORQUE, initial_state=START, effects=attached(), substeps=4)
    np.testing.assert_array_equal(both.outputs, all_given.outputs)


def test_steps_are_chosen_for_the_effects_that_are_carried():
    bare = parse_model(OSCILLATOR, "o.toml")
    steep = load_effect("viscous-damping", "joint").attach(
        "hinge", coefficient=500.0
    )  # 4 ms, the samples 10 ms apart
    given = {"initial_state": START}
    carried = suggest_substeps(bare.with_effects([steep]), TIME_S, TORQUE, **given)
    assert carried == suggest_substeps(bare, TIME_S, TORQUE, effects=[steep], **given)
    assert carried > suggest_substeps(bare, TIME_S, TORQUE, **given)


def test_prepared_inputs_and_other_values_keep_the_effects():
    model = parse_model(OSCILLATOR + FRICTION, "o.toml")
    changed = pickle.loads(pickle.dumps(model)).with_values({"damping": 1.7}).with_between({"torque": "hold"})
    drive = prepare(changed, TIME_S, TORQUE, 4)
    bare = parse_model(OSCILLATOR, "o.toml").with_between({"torque": "hold"})
    expected = simulate(
        bare, TIME_S, TORQUE, parameters={"damping": 1.7}, initial_state=START, effects=attached(), substeps=4
    )
    np.testing.assert_array_equal(
        simulate(changed, TIME_S, drive, initial_state=START).outputs, expected.outputs
    )


def test_a_stepper_adds_the_effects_that_are_carried():
    bare = parse_model(OSCILLATOR, "o.toml")
    model = parse_model(OSCILLATOR + FRICTION, "o.toml")
    steps = [Stepper(model, step_s=0.01), Stepper(bare, effects=attached(), step_s=0.01)]
    carried, given = [step.advance(TORQUE) for step in steps]
    np.testing.assert_array_equal(carried, given)


def test_a_model_without_states_may_carry_a_filter():
    text = 'name = "wire"\ninputs = ["u"]\n[outputs]\ny = "u"\n'
    lag = '[[effects]]\neffect = "lag"\nsite = "u"\nvalues = { time_constant = 0.1 }\n'
    time_s = np.linspace(0.0, 1.0, 1001)
    result = simulate(parse_model(text + lag, "w.toml"), time_s, time_s[:, None]).outputs[:, 0]
    np.testing.assert_allclose(result, time_s - 0.1 * (1 - np.exp(-time_s / 0.1)), atol=1e-9)


FAULTS = {
    'effect = "colomb-friction"\nsite = "hinge"': (3, "effects[1].effect = ", "coulomb-friction"),
    'effect = "coulomb-friction"\nsite = "hing"\nvalues = { torque = 1 }': (4, "has no site 'hing'", '"hinge"'),
    'effect = "coulomb-friction"\nsite = "hinge"\nkind = "join"': (5, 'kind = "join": expected', '"joint"'),
    'effect = "coulomb-friction"\nsite = "torque"\nvalues = { torque = 1 }': (3, "sits at joint sites", ""),
    'effect = "coulomb-friction"\nsite = "hinge"\nvalues = { torqe = 1 }': (5, "unknown key", '"torque"'),
    'effect = "coulomb-friction"\nsite = "hinge"\nvalues = { torque = "1" }': (5, "expected a number", ""),
    'effect = "coulomb-friction"\nsite = "hinge"\nvalues = { torque = -1 }': (5, "expected 0 or more", ""),
    'effect = "coulomb-friction"\nsite = "hinge"\nvalues = { torque = inf }': (5, "a finite number", ""),
    'effect = "coulomb-friction"\nsite = "hinge"\nvalues = { torque = nan }': (5, "expected a finite number", ""),
    'effect = "viscoelastic-creep"\nsite = "hinge"\nvalues = { stiffness = 1 }': (5, "a value of time_constant", ""),
    'effect = "viscoelastic-creep"\nsite = "hinge"\n[effects.values]\nstiffness = 1\ntime_constant = 0': (
        7, "a number above 0", "",
    ),
    'effect = "coulomb-friction"': (2, 'the key "site" is missing', ""),
    'effect = "bias"\nsite = "torque"\nvalues = { offset = 1 }': (2, "input and output sites", 'kind = "input"'),
    'effect = "coulomb-friction"\nplace = "hinge"': (4, "unknown key", ""),
}  # fmt: skip


@pytest.mark.parametrize("table", FAULTS)
def test_a_fault_in_a_table_of_effects_is_reported_with_its_line(table):
    line, message, hint = FAULTS[table]
    good = '[[effects]]\neffect = "viscous-damping"\nsite = "hinge"\nvalues = { coefficient = 1 }\n'
    before = OSCILLATOR + good
    with pytest.raises(ModelError) as caught:
        parse_model(f"{before}\n[[effects]]\n{table}\n", "arm.toml")
    shown = str(caught.value)
    assert f"arm.toml:{before.count(chr(10)) + line}:" in shown
    assert message in shown
    assert hint in shown


def test_an_effect_without_what_it_needs_at_the_site_is_refused():
    text = OSCILLATOR.replace('load = "10*angle"', "")
    table = (
        '[[effects]]\neffect = "load-dependent-friction"\nsite = "hinge"\nvalues = { coefficient = 0.1 }\n'
    )
    with pytest.raises(ModelError, match=r"needs the load at site hinge.*add load ="):
        parse_model(text + table, "arm.toml")


def test_effects_that_are_no_tables_are_refused():
    with pytest.raises(ModelError, match=r"effects = .*expected a list"):
        parse_model('effects = "friction"\n' + OSCILLATOR, "arm.toml")


def test_a_file_may_refer_to_another_model(tmp_path):
    (tmp_path / "base.toml").write_text(OSCILLATOR)
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "better.toml").write_text(
        'name = "better"\nbase = "../base.toml"\n[values]\ndamping = 1.7\n' + FRICTION
    )
    better = load_model(tmp_path / "sub" / "better.toml")
    assert better.name == "better"
    expected = simulate(
        parse_model(OSCILLATOR, "o.toml"), TIME_S, TORQUE, parameters={"damping": 1.7},
        initial_state=START, effects=attached(), substeps=4,
    )  # fmt: skip
    result = simulate(better, TIME_S, TORQUE, initial_state=START, substeps=4)
    np.testing.assert_array_equal(result.outputs, expected.outputs)


BASE_FAULTS = {
    'base = "bse.toml"': r"b.toml:1:.* cannot find the model file",
    'base = "hinge-pendulun"': r"b.toml:1:.*unknown model 'hinge-pendulun'; did you mean",
    'base = "b.toml"': r"deep",
    'base = "hinge-pendulum"\n[values]\nstifness = 1.0': r"b.toml:3:1: values.stifness.* did you mean .stiffness.",
    'base = "hinge-pendulum"\n[values]\ninertia = -1.0': r"b.toml:3:11: .*expected a number from 0 to inf",
    'base = "hinge-pendulum"\n[parameters]\ninertia = 1.0': r"b.toml:2:2: parameters: unknown key",
    'base = "hinge-pendulum"\n[[effects]]\neffect = "delay"\nsite = "angel"': r"b.toml:4.*did you mean .angle.",
}


@pytest.mark.parametrize("text", BASE_FAULTS)
def test_a_fault_in_a_file_with_a_base_is_reported(text, tmp_path):
    (tmp_path / "b.toml").write_text(text)
    with pytest.raises(ModelError, match=BASE_FAULTS[text]):
        load_model(tmp_path / "b.toml")


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("rate", ["speed", "2*speed"])
def test_an_inertia_in_a_model_without_states_is_accelerated_as_the_inputs_are(rate, substeps):
    """Inverse dynamics: position and rate are recorded, and the torque is what is asked for."""
    model = parse_model(
        f"""
        name = "inverse"
        inputs = ["position", "speed"]
        [outputs]
        torque = "5.0*position - force.shaft"
        [sites.shaft]
        kind = "joint"
        coordinate = "position"
        rate = "{rate}"
        """,
        "inverse.toml",
    )
    inertia = load_effect("added-inertia").attach("shaft", inertia=0.3)
    w = 6.0
    inputs = np.column_stack([np.sin(w * TIME_S), w * np.cos(w * TIME_S)])
    driven = prepare(model, TIME_S, inputs, substeps)
    torque = simulate(model, TIME_S, driven, effects=[inertia]).outputs[:, 0]
    factor = 2.0 if rate == "2*speed" else 1.0
    expected = 5.0 * inputs[:, 0] - 0.3 * factor * w**2 * np.sin(w * TIME_S)
    # inputs are linear between samples: the slope of the speed is that of the middle of an interval
    halfway = 0.5 * w * (TIME_S[1] - TIME_S[0])
    np.testing.assert_allclose(torque, expected, atol=1.1 * halfway * 0.3 * factor * w**2)
