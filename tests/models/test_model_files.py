import numpy as np
import pytest
from equations import FOLLOWER, OSCILLATOR, PENDULUM

from labrun.effects import load_effect
from labrun.errors import ModelError
from labrun.models import Site, load_model, parse_model, simulate


def test_everything_a_file_says_is_in_the_model():
    model = parse_model(OSCILLATOR, "oscillator.toml")
    assert model.states == ("angle", "rate")
    assert [signal.name for signal in model.inputs] == ["torque"]
    assert [output.name for output in model.outputs] == ["angle", "torque", "spring"]
    inertia, stiffness, _ = model.parameters
    assert (inertia.value, inertia.tolerance, inertia.unit) == (2.0, 0.1, "kg m^2")
    assert stiffness.tolerance == "free"
    assert model.sites == (Site("hinge", "joint", "angle", "rate", "10*angle", "stiffness"),)
    assert model.initial == {"angle": "first", "rate": 0.0}
    assert [(location.name, location.kind) for location in model.places][1:] == [
        ("torque", "input"), ("angle", "output"), ("torque", "output"), ("spring", "output"),
    ]  # fmt: skip


def test_a_spring_that_a_condition_exchanges_is_an_expression():
    text = OSCILLATOR.replace('stiffness = "stiffness"', 'stiffness = "stiffness*strip_mm/25"')
    model = parse_model(text, "oscillator.toml")
    assert model.conditions == ("strip_mm",)
    offset = load_effect("rest-offset").attach("hinge", offset=0.1)
    time_s, still = np.linspace(0.0, 1.0, 11), np.zeros((11, 1))
    narrow, wide = (
        simulate(model, time_s, still, condition={"strip_mm": width}, effects=[offset], initial_state=[0, 0])
        for width in (12.5, 25.0)
    )
    assert narrow.outputs[1, 0] == pytest.approx(0.5 * wide.outputs[1, 0], rel=1e-2)


def test_names_that_are_nothing_else_are_conditions():
    model = parse_model(FOLLOWER.replace("(u - y)/tau", "(gain*u - y + offset)/tau"), "f.toml")
    assert model.conditions == ("gain", "offset")
    with pytest.raises(ModelError, match=r"'offset'.*condition has no 'offset'"):
        model.vector(None, {"gain": 1.0})
    with pytest.raises(ModelError, match="as a number; here it is 'large'"):
        model.vector(None, {"gain": "large", "offset": 0.0})


WORDS = """
[conditions]
gain   = { words = { small = 0.5, large = 2.0 }, default = "small" }
offset = { of = "gain", words = { small = 0.0, large = 7.0 }, default = 3.0 }
"""


def test_a_word_of_a_condition_stands_for_numbers_and_may_be_left_out():
    model = parse_model(FOLLOWER.replace("(u - y)/tau", "(gain*u - y + offset)/tau") + WORDS, "f.toml")
    assert model.vector(None, {"gain": "large"})[-2:].tolist() == [2.0, 7.0]
    assert model.vector(None, {"gain": 4.0})[-2:].tolist() == [4.0, 4.0]
    assert model.vector(None, {})[-2:].tolist() == [0.5, 3.0]
    with pytest.raises(ModelError, match="no number for gain = 'lrge'") as error:
        model.vector(None, {"gain": "lrge"})
    assert "large" in str(error.value.hint)


def test_a_default_that_is_no_known_word_is_refused_at_its_line():
    text = FOLLOWER.replace("(u - y)/tau", "(gain*u - y)/tau")
    with pytest.raises(ModelError, match=r"f.toml:\d+:\d+: conditions.gain.default.*'huge'"):
        parse_model(text + '\n[conditions.gain]\nwords = { small = 0.5 }\ndefault = "huge"\n', "f.toml")


def test_a_state_without_a_rule_starts_free():
    model = parse_model(PENDULUM, "p.toml")
    assert model.initial == {"angle": "free", "rate": "free"}
    assert model.initial_state({}, first={"angle": 0.2}, free={"rate": 3.0}).tolist() == [0.2, 3.0]


def test_states_start_at_conditions_and_first_samples():
    model = parse_model(OSCILLATOR.replace("rate = 0.0", 'rate = "kick"'), "o.toml")
    assert model.initial_state({"kick": 2.5}, first={"angle": -0.1}).tolist() == [-0.1, 2.5]
    with pytest.raises(ModelError, match="no such condition"):
        model.initial_state({}, first={"angle": 0.0})
    with pytest.raises(ModelError, match="first samples of output 'angle'"):
        model.initial_state({"kick": 1.0})


def test_inputs_may_say_their_unit_and_how_they_run_between_samples():
    text = FOLLOWER.replace('inputs = ["u"]', "").replace(
        "[parameters]", '[inputs]\nu = { unit = "V", between = "hold" }\n[parameters]'
    )
    (port,) = parse_model(text, "f.toml").inputs
    assert (port.unit, port.between) == ("V", "hold")


SHARED = OSCILLATOR.replace(
    "[equations]", '[where]\npull = "stiffness*angle"\nall = "pull + damping*rate"\n[equations]'
)
SHARED = SHARED.replace("- stiffness*angle - damping*rate", "- all").replace(
    '"stiffness*angle - f', '"pull - f'
)


def test_expressions_that_equations_share_are_named_once_and_give_the_same_simulation():
    time_s = np.linspace(0.0, 3.0, 301)
    torque = np.sin(3.0 * time_s)[:, None]
    results = [
        simulate(parse_model(text, "o.toml"), time_s, torque, initial_state=[0.2, -1.0])
        for text in (OSCILLATOR, SHARED)
    ]
    # what is summed in another order differs by rounding
    np.testing.assert_allclose(results[0].outputs, results[1].outputs, rtol=0, atol=1e-12)


SHARED_FAULTS = {
    (
        'pull = "stiffness*angle"',
        'pull = "0.5*all + stiffness*angle"',
    ): "where.pull = .*'all' is not known here",
    ('all = "pull', 'all = "all + pull'): "where.all = .*'all' is not known here",
    ('all = "', 'more = "pull*angle"\nall = "'): "where.more = .*: no equation uses 'more'",
    ('all = "pull', 'all = "force.hinge + pull'): "cannot be made by the force at a site",
    ("pull", "angle"): "where.angle = .*'angle' is already the name of something else",
    (
        'inputs = ["torque"]',
        'inputs = ["torque"]\nconditions = ["pull"]',
    ): "where.pull = .*'pull' is already the name",
    ('all = "pull', 'all = "pul + pull'): None,
}


@pytest.mark.parametrize(("change", "message"), SHARED_FAULTS.items(), ids=range(len(SHARED_FAULTS)))
def test_a_fault_of_a_shared_expression_is_told_at_its_key(change, message):
    text = SHARED.replace(*change, 1)
    assert text != SHARED
    if message is None:
        assert parse_model(text, "bad.toml").conditions == ("pul",)
        return
    with pytest.raises(ModelError, match=f"(?s){message}"):
        parse_model(text, "bad.toml")


def test_a_parameter_that_a_load_alone_uses_through_a_shared_expression_is_noted():
    text = OSCILLATOR.replace("[equations]", 'mass = 3.0\n[where]\nweight = "mass*9.81"\n[equations]')
    (note,) = parse_model(text.replace("10*angle", "weight"), "o.toml").notes
    assert note.startswith("parameter 'mass' is used by the load of a site only")


def test_an_input_that_nothing_uses_is_noted():
    model = parse_model(FOLLOWER.replace('["u"]', '["u", "enable"]'), "f.toml")
    assert model.notes == ("input 'enable' is used by no equation",)


def test_a_parameter_that_only_a_load_uses_is_noted():
    text = OSCILLATOR.replace("[equations]", "mass = 3.0\n[equations]").replace("10*angle", "mass*9.81")
    (note,) = parse_model(text, "o.toml").notes
    assert note.startswith("parameter 'mass' is used by the load of a site only")


def test_an_unknown_site_is_told_with_the_nearest_one():
    model = parse_model(OSCILLATOR, "o.toml")
    with pytest.raises(ModelError, match=r"oscillator has no site 'hing'\n  did you mean .hinge."):
        model.site_named("hing")
    with pytest.raises(ModelError, match=r"has no output site 'hinge'"):
        model.site_named("hinge", "output")
    with pytest.raises(ModelError, match=r"has no joint site 'hinge'\n  it has no joint site at all"):
        parse_model(FOLLOWER, "f.toml").site_named("hinge", "joint")


EQUATION_FAULTS = {
    "-stiffness*sine(angle)": ("unknown function 'sine'", 11, 'did you mean "sin"?'),
    "stiffness*angle)": ("never opened", 15, ""),
    "(stiffness*angle": ("never closed", 0, ""),
    "stiffness angle": ("is an operator missing", 10, ""),
    "stiffness**": ("something is missing behind", 10, ""),
    "2^^angle": ("does not continue here", 2, ""),
    "force.knee": ("unknown site 'knee'", 0, 'did you mean "hinge"?'),
    "angle.real": ("only force.<site> has a dot", 0, ""),
    "angle^2 + sin": ("sin is a function", 10, ""),
    "clip(angle, 1)": ("clip takes 3 values, not 2", 0, ""),
    "max(angle)": ("max takes two or more", 0, ""),
    "sin(x=1)": ("plain values", 0, ""),
    "2(angle)": ("a product needs *", 0, ""),
    "angle := 3": ("means nothing in an expression", 6, ""),
    "[angle]": ("means nothing in an expression", 0, ""),
    "'angle'": ("no words", 0, ""),
    "3 · angle": ("means nothing in an expression", 2, "write * for a product"),
    "angle, rate": ("not arithmetic", 0, ""),
    "1e999*angle": ("too large", 0, ""),
    "True*angle": ("True is not a real number", 0, ""),
    "3j": ("not a real number", 0, ""),
    "angle // 2": ("not arithmetic", 0, ""),
    "__import__": ("not a name for a quantity", 0, ""),
    "lambda": ("something is missing", 5, ""),
    "": ("is empty", 0, ""),
    "(" * 300 + "1" + ")" * 300: ("nested too deeply", None, ""),
    "-" * 300 + "1": ("nested too deeply", None, ""),
    "1+" * 3000 + "1": ("characters are too many", None, ""),
}


@pytest.mark.parametrize(("equation", "expected"), EQUATION_FAULTS.items(), ids=range(len(EQUATION_FAULTS)))
def test_a_broken_equation_is_reported_with_its_place(equation, expected):
    message, position, hint = expected
    # the equation stands on line 11 of the file
    text = OSCILLATOR.replace("(torque + force.hinge - stiffness*angle - damping*rate) / inertia", equation)
    with pytest.raises(ModelError, match=message) as caught:
        parse_model(text, "broken.toml")
    assert str(caught.value).startswith("broken.toml:11:9: equations.rate = ")
    if position is not None:
        shown, caret = str(caught.value).splitlines()[1:3]
        assert shown == f"    {equation}"
        assert caret == " " * (4 + position) + "^"
    assert hint in str(caught.value)


FILE_FAULTS = {
    ("inputs", "input"): "bad.toml:4:1: input = .*unknown key; did you mean .inputs.",
    ("tolerance = 0.1", "tolerence = 0.1"): "parameters.inertia.tolerence.*did you mean .tolerance.",
    ("tolerance = 0.1", "tolerance = -0.1"): "tolerance = -0.1: expected at least 0 or .free.",
    ("tolerance = 0.1", 'tolerance = "some"'): 'expected a number or "free"',
    ("value = 2.0,", "value = 2.0, lower = 3,"): "the value 2 is outside of its bounds 3 to inf",
    ("value = 2.0", 'value = "2"'): 'value = "2": expected a number',
    ("value = 2.0", "value = nan"): "expected a finite number",
    ("value = 2.0", "worth = 2.0"): 'the key "value" is missing.*worth = 2.0: unknown key',
    ("damping*rate", "dampng*rate"): "no equation uses 'damping'.*dampng.*check the spelling",
    ('rate  = "(torque', 'speed = "(torque'): "unknown state 'speed'",
    ('angle = "rate"', ""): "state 'angle' has no equation",
    ('["angle", "rate"]', '["angle", "rate", "angle"]'): "duplicate name",
    ('["angle", "rate"]', '["angle", "rate", "sin"]'): "is reserved in equations",
    ('["angle", "rate"]', '["angle", "rate", "lambda"]'): "equations cannot use the name .lambda.",
    ('["torque"]', '["torque", "rate"]'): "'rate' is already the name of a state",
    ('["torque"]', '"torque"'): "expected a list of names",
    ('kind = "joint"', 'kind = "knee"'): 'expected "joint" or "body"',
    ('kind = "joint"', 'kind = "output"'): 'expected "joint" or "body"',
    (
        'stiffness = "stiffness"',
        'stiffness = "stifness"',
    ): "unknown parameter 'stifness'.*did you mean .stiffness.",
    ('load = "10*angle"', 'load = "10*force.hinge"'): "cannot be described by the force",
    ('load = "10*angle"', 'loads = "10*angle"'): "sites.hinge.loads.*did you mean .load.",
    (" - force.hinge", ""): None,
    ("rate = 0.0", 'angel = "first"'): "initial.angel.*did you mean .angle.",
    ("rate = 0.0", 'rate = "first"'): "the model has no output 'rate'",
    ("rate = 0.0", 'rate = "two words"'): "neither a number",
    ('name = "oscillator"', ""): 'the key "name" is missing',
    ("states = ", "states = = "): "bad.toml:3:10: not valid TOML",
}


@pytest.mark.parametrize(("change", "message"), FILE_FAULTS.items(), ids=range(len(FILE_FAULTS)))
def test_a_fault_of_a_file_is_reported_by_its_key(change, message):
    text = OSCILLATOR.replace(*change, 1)
    assert text != OSCILLATOR
    if message is None:
        assert parse_model(text, "bad.toml")
        return
    with pytest.raises(ModelError) as caught:
        parse_model(text, "bad.toml")
    assert str(caught.value).startswith("bad.toml")
    import re

    assert re.search(message, str(caught.value), re.DOTALL)


def test_all_faults_of_a_file_are_told_at_once():
    text = (
        OSCILLATOR.replace("tolerance", "tolerence")
        .replace("- damping*rate", "- damping*")
        .replace("joint", "j")
    )
    with pytest.raises(ModelError) as caught:
        parse_model(text, "bad.toml")
    assert [problem["key"] for problem in caught.value.details["problems"]] == [
        "parameters.inertia.tolerence", "equations.rate", "sites.hinge.kind",
    ]  # fmt: skip
    text = OSCILLATOR.replace('spring = "stiffness*angle', 'spring = "force.knee').replace(
        '"first"', '"last one"'
    )
    with pytest.raises(ModelError, match=r"(?s)2 errors.*unknown site 'knee'.*initial\.angle"):
        parse_model(text, "bad.toml")


def test_a_site_without_its_force_in_any_equation_is_an_error():
    text = OSCILLATOR.replace(" + force.hinge", "").replace(" - force.hinge", "")
    with pytest.raises(ModelError, match=r"sites\.hinge: no equation uses force\.hinge"):
        parse_model(text, "bad.toml")


def test_declared_conditions_catch_misspelt_names_at_once():
    text = FOLLOWER.replace('inputs = ["u"]', 'inputs = ["u"]\nconditions = ["kp"]').replace(
        "(u - y)", "(kp*u - z)"
    )
    with pytest.raises(ModelError, match="unknown name 'z'"):
        parse_model(text, "f.toml")


def test_models_are_found_by_path_by_name_and_by_dotted_name(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(FOLLOWER)
    assert load_model(path).name == "follower"
    assert load_model(str(path)).source == str(path)
    assert load_model("hinge-pendulum").sites[0].stiffness == "stiffness"
    with pytest.raises(ModelError, match=r"unknown model 'hinge-pendulm'.*\n.*hinge-pendulum"):
        load_model("hinge-pendulm")
    with pytest.raises(ModelError, match="cannot find the model file"):
        load_model(tmp_path / "absent.toml")
    with pytest.raises(ModelError, match="is not a labrun model but module"):
        load_model("os:path")
