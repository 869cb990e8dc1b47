"""TOML files of effects: what an entry says is what is simulated, and a fault in it is told with its place."""

import numpy as np
import pytest

from labrun.effects import load_effect, read_effects
from labrun.errors import ModelError, PluginError
from labrun.models import corrected_model_text, parse_model, simulate

TIME = np.linspace(0, 1, 51)
FRICTION = """
[shared]
speed = { quantity = "rate", lower = 1e-3, upper = 0.5, starts = [0.05, 0.1], held = true }
[stiction]
title  = "Friction that falls as the joint begins to slide."
kind   = "joint"
F      = "-torque*fall*tanh(rate/speed) - drag*dz"
where  = { fall = "exp(-(rate/speed)^2)" }
states = { z = "(q - z)/0.1" }
source = "Stribeck 1902"
[stiction.parameters]
torque = { quantity = "force", neutral = 0.0, lower = 0.0, upper = 2.0, starts = [0.1] }
drag   = { quantity = "damping", neutral = 0.0, lower = 0.0, upper = 2.0, starts = [0.2] }
speed  = "shared"
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "friction.toml"
    path.write_text(FRICTION)
    return path


def test_an_effect_of_a_file_acts_as_its_equation_says(file):
    effect = load_effect(f"{file}:stiction")
    assert effect.states == 1
    assert [parameter.name for parameter in effect.parameters if parameter.shape] == ["speed"]
    law = effect.function.python
    z, dz = np.array([0.1]), np.zeros(1)
    force = law(0.0, 0.3, 0.02, 0.0, 0.0, 0.0, np.array([2.0, 0.5, 0.05]), z, dz)
    assert dz[0] == pytest.approx(2.0)
    assert force == pytest.approx(-2.0 * np.exp(-0.16) * np.tanh(0.4) - 0.5 * 2.0)


def test_a_model_saved_with_it_names_its_file(file):
    attached = load_effect(f"{file}:stiction").attach("hinge", torque=0.5)
    text = (
        'name = "m"\nstates = ["q", "v"]\n[equations]\nq = "v"\nv = "force.hinge - q"\n[outputs]\nq = "q"\n'
        '[sites.hinge]\nkind = "joint"\ncoordinate = "q"\nrate = "v"\n'
    )
    model = parse_model(text, "m.toml")
    saved = parse_model(corrected_model_text(model, text, {}, [attached]), "saved.toml")
    given = (TIME, np.empty((51, 0)))
    there = simulate(saved, *given, initial_state=[0.3, 0.0], substeps=2).outputs
    here = simulate(model, *given, initial_state=[0.3, 0.0], effects=[attached], substeps=2).outputs
    assert np.array_equal(there, here)


@pytest.mark.parametrize(
    ("line", "instead", "message"),
    [
        (
            'z = "(q - z)/0.1"',
            'z = "(q - zz)/0.1"',
            r"friction.toml:9:\d+: stiction.states.z .* unknown name 'zz'",
        ),
        ("tanh(rate/speed)", "tanh(rat/speed)", r"stiction.F .* unknown name 'rat'; did you mean \"rate\""),
        ("tanh(rate/speed)", "tanh(rate/speed", r"stiction.F .*never closed"),
        (
            'kind   = "joint"',
            'kind   = "output"',
            "at output sites needs either y, its equation, or a function",
        ),
        ('kind   = "joint"', 'kind   = ["joint", "input"]', "either for joints and bodies or for inputs"),
        ('"force", neutral', '"forces", neutral', r"stiction.parameters.torque.quantity"),
        ("where  =", "wher   =", 'stiction.wher: .*did you mean "where"'),
        ("held = true", 'held = true, instead_of = "torque"', "stands in for another shape of its effect"),
    ],
)
def test_a_fault_of_an_entry_is_told_with_its_key(file, line, instead, message):
    file.write_text(FRICTION.replace(line, instead))
    with pytest.raises(ModelError, match=message):
        read_effects(file)


def test_a_misspelt_id_in_a_file_is_told(file):
    with pytest.raises(PluginError, match=r"has no effect 'stictin'"):
        load_effect(f"{file}:stictin")
