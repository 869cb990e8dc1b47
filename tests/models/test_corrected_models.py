"""The file of a corrected model: what changed is in it, all else is as it was, and it simulates the same."""

import tomllib

import numpy as np
import pytest
from equations import OSCILLATOR

from labrun.effects import load_effect
from labrun.errors import ModelError
from labrun.models import corrected_model_text, load_model, parse_model, simulate

TIME_S = np.linspace(0.0, 2.0, 201)
TORQUE = np.sin(7.0 * TIME_S)[:, None]
START = [0.05, 0.0]
FRICTION = load_effect("coulomb-friction").attach("hinge", torque=0.3)
LAG = load_effect("lag", "output").attach("angle", time_constant=0.02)

PYTHON_MODEL = """
from labrun.models import Parameter, Site, python_model


def derivative(t, x, u, p, force, dx):
    dx[0] = x[1]
    dx[1] = force[0] - p[0] * x[0]


def output(t, x, u, p, force, y):
    y[0] = x[0]


MODEL = python_model(
    "spring", derivative=derivative, output=output, states=["angle", "rate"], outputs=["angle"],
    parameters=[Parameter("stiffness", 50.0, 0.1)], sites=[Site("hinge", "joint", "angle", "rate")],
)
"""


def outputs(model, **given):
    inputs = TORQUE if model.inputs else np.empty((len(TIME_S), 0))
    return simulate(model, TIME_S, inputs, initial_state=START, substeps=4, **given).outputs


def test_values_are_replaced_in_place_and_effects_appended():
    text = OSCILLATOR.replace("damping   = {", "# what the bearing does\ndamping   = {")
    model = parse_model(text, "arm.toml")
    written = corrected_model_text(
        model, text, {"damping": 1.7, "stiffness": 50.0}, [FRICTION, LAG], "fitted to seven trials\nof a day"
    )
    expected = text.replace("value = 0.8", "value = 1.7").strip()
    assert expected in written
    before, after = written.split(expected)
    assert [line for line in before.splitlines() if line and not line.startswith("#")] == []
    for message in (
        "arm.toml",
        "# fitted to seven trials\n# of a day\n",
        "damping: 0.8 N m s/rad became 1.7 N m s/rad",
    ):
        assert message in before
    assert "stiffness" not in before
    assert tomllib.loads(after)["effects"] == [
        {"effect": "coulomb-friction", "site": "hinge", "kind": "joint",
         "values": {"torque": 0.3, "transition_speed": 0.01}},
        {"effect": "lag", "site": "angle", "kind": "output", "values": {"time_constant": 0.02}},
    ]  # fmt: skip


def test_a_corrected_file_simulates_as_the_model_with_values_and_effects(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(OSCILLATOR)
    values = {"damping": 1.0 / 3.0, "inertia": 2.2}
    written = corrected_model_text(load_model(path), path, values, [FRICTION, LAG])
    (tmp_path / "better.toml").write_text(written)
    better = load_model(tmp_path / "better.toml")
    given = {"parameters": values, "effects": [FRICTION, LAG]}
    np.testing.assert_array_equal(outputs(better), outputs(parse_model(OSCILLATOR, "o"), **given))
    assert [parameter.tolerance for parameter in better.parameters] == [0.1, "free", "free"]


LAYOUTS = {
    "a bare number": ("damping   = { value = 0.8, unit = \"N m s/rad\" }", "damping = 0.8"),
    "a table": (
        "[equations]", "[parameters.slack]\n# loose\nvalue = 0.8\nunit = \"1\"\n[equations]",
    ),
    "dotted keys": ("damping   = { value = 0.8, unit = \"N m s/rad\" }", "damping.value = 0.8\ndamping.unit = \"1\""),
}  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_parameter_may_be_written_in_any_way(layout):
    text = OSCILLATOR.replace(*LAYOUTS[layout])
    name = "slack" if "slack" in text else "damping"
    if name == "slack":
        text = text.replace("damping*rate", "(damping + slack)*rate")
    written = corrected_model_text(parse_model(text, "arm.toml"), text, {name: 1.7})
    value = {parameter.name: parameter.value for parameter in parse_model(written, "arm.toml").parameters}
    assert value[name] == 1.7
    assert text.strip().replace("0.8\n", "1.7\n").count("\n") == written.split("\n\n", 1)[1].strip().count(
        "\n"
    )


def test_a_second_correction_adds_to_the_first():
    once = corrected_model_text(parse_model(OSCILLATOR, "a"), OSCILLATOR, {"damping": 1.7}, [FRICTION])
    twice = corrected_model_text(parse_model(once, "b"), once, {"damping": 1.9}, [LAG])
    model = parse_model(twice, "c")
    assert [effect.effect.id for effect in model.effects] == ["coulomb-friction", "lag"]
    given = {"parameters": {"damping": 1.9}, "effects": [FRICTION, LAG]}
    np.testing.assert_array_equal(outputs(model), outputs(parse_model(OSCILLATOR, "o"), **given))


@pytest.mark.parametrize(
    "inline", ["[]", '[{ effect = "lag", site = "angle", values = { time_constant = 0.1 } }, ]']
)
def test_effects_in_an_inline_array_are_extended(inline):
    text = OSCILLATOR.replace("[parameters]", f"effects = {inline}\n[parameters]")
    model = parse_model(text, "arm.toml")
    better = parse_model(corrected_model_text(model, text, {}, [FRICTION]), "better.toml")
    assert better.effects == (*model.effects, FRICTION)


def test_a_model_without_a_text_is_referred_to(tmp_path, monkeypatch):
    (tmp_path / "spring_model.py").write_text(PYTHON_MODEL)
    monkeypatch.syspath_prepend(tmp_path)
    model = load_model("spring_model:MODEL")
    written = corrected_model_text(model, "spring_model:MODEL", {"stiffness": 60.0}, [FRICTION])
    assert 'base = "spring_model:MODEL"' in written
    (tmp_path / "better.toml").write_text(written)
    given = {"parameters": {"stiffness": 60.0}, "effects": [FRICTION]}
    np.testing.assert_array_equal(outputs(load_model(tmp_path / "better.toml")), outputs(model, **given))


VALUES = {
    "no values": "",
    "a table": "[values]\ndamping = 1.1 # felt\n",
    "an inline table": "values = { damping = 1.1 }\n",
    "an empty inline table": "values = {}\n",
    "dotted keys": "values.damping = 1.1\n",
}


@pytest.mark.parametrize("values", VALUES)
@pytest.mark.parametrize(
    "effects", ["", '[[effects]]\neffect = "bias"\nsite = "angle"\nvalues = { offset = 0.1 }\n']
)
def test_a_file_with_a_base_is_corrected_again(values, effects, tmp_path):
    (tmp_path / "base.toml").write_text(OSCILLATOR)
    path = tmp_path / "once.toml"
    path.write_text(f'base = "base.toml"\n{VALUES[values]}{effects}')
    once = load_model(path)
    folder = tmp_path / "deeper"
    folder.mkdir()
    written = corrected_model_text(once, path, {"damping": 1.7, "inertia": 2.2}, [FRICTION], folder=folder)
    (folder / "twice.toml").write_text(written)
    twice = load_model(folder / "twice.toml")
    assert 'base = "../base.toml"' in written
    assert ("# felt" in written) == ("# felt" in VALUES[values])
    given = {"parameters": {"damping": 1.7, "inertia": 2.2}, "effects": [FRICTION]}
    np.testing.assert_array_equal(outputs(twice), outputs(once, **given))


def test_a_model_that_ships_with_labrun_is_written_whole():
    model = load_model("hinge-pendulum")
    written = corrected_model_text(model, "hinge-pendulum", {"stiffness": 0.02})
    better = parse_model(written, "better.toml")
    assert "the hinge" in written
    assert {parameter.name: parameter.value for parameter in better.parameters}["stiffness"] == 0.02


def test_what_cannot_be_written_is_refused():
    model = parse_model(OSCILLATOR, "arm.toml")
    with pytest.raises(ModelError, match=r"no parameter 'dampng'.*\n.*damping"):
        corrected_model_text(model, OSCILLATOR, {"dampng": 1.0})
    with pytest.raises(ModelError, match="damping = nan cannot be written"):
        corrected_model_text(model, OSCILLATOR, {"damping": np.nan})
    with pytest.raises(ModelError, match="no joint site 'knee'"):
        corrected_model_text(model, OSCILLATOR, {}, [load_effect("coulomb-friction").attach("knee")])
    with pytest.raises(ModelError, match="the text given for model oscillator has no parameter 'damping'"):
        corrected_model_text(model, 'name = "other"\n[parameters]\nmass = 1\n', {"damping": 1.0})


def test_an_effect_that_is_not_installed_is_named_by_its_module(tmp_path, monkeypatch):
    (tmp_path / "glue_effect.py").write_text(
        "from labrun.effects import Effect, EffectParameter, force_law\n\n\n"
        "def law(t, q, rate, acceleration, load, stiffness, values, z, dz):\n    return -values[0] * q\n\n\n"
        'GLUE = Effect("glue", "joint", (EffectParameter("strength", "stiffness", 0.0, 0.0, 1.0, (0.1,)),),\n'
        '              force_law(law), "F = -strength q", "a test")\n'
    )
    monkeypatch.syspath_prepend(tmp_path)
    glue = load_effect("glue_effect:GLUE").attach("hinge", strength=3.0)
    written = corrected_model_text(parse_model(OSCILLATOR, "a"), OSCILLATOR, {}, [glue])
    assert 'effect = "glue_effect:GLUE"' in written
    assert parse_model(written, "b").effects == (glue,)
