import math

import numpy as np
import pytest

from labrun.effects import load_effect
from labrun.errors import ModelError
from labrun.models import Parameter, Site, load_model, python_model, simulate

TABLE = np.linspace(0.0, 3.0, 50_000) ** 2


def derivative(t, x, u, p, force, dx):
    dx[0] = x[1]
    dx[1] = (u[0] + force[0] - p[0] * math.sin(x[0])) / p[1]


def output(t, x, u, p, force, y):
    scaled = 3.0 + min(abs(x[0]), 3.0) / 3.0 * 49_999
    y[0] = p[int(scaled)]
    y[1] = x[0]


MODEL = python_model(
    "table-pendulum",
    derivative=derivative,
    output=output,
    states=["angle", "rate"],
    inputs=["torque"],
    outputs=["looked_up", "angle"],
    parameters=[Parameter("weight", 9.0), Parameter("inertia", 1.0)],
    conditions=["unused"],
    sites=[Site("hinge", "joint", "angle", "rate")],
    constants=TABLE,
)


def make() -> object:
    return MODEL


def test_a_model_of_functions_reads_a_large_table_behind_its_parameters():
    result = simulate(
        MODEL,
        np.linspace(0, 0.4, 41),
        np.zeros((41, 1)),
        condition={"unused": 0.0},
        initial_state=[2.0, 0.0],
        substeps=4,
    )
    assert result.outputs[:, 0] == pytest.approx(result.outputs[:, 1] ** 2, abs=1e-3)


def test_effects_attach_to_a_model_of_functions():
    heavier = load_effect("added-inertia").attach("hinge", inertia=0.5)
    given = {"condition": {"unused": 0.0}, "initial_state": [1.0, 0.0], "substeps": 4}
    time_s, u = np.linspace(0, 2, 101), np.zeros((101, 1))
    with_effect = simulate(MODEL, time_s, u, effects=[heavier], **given)
    with_value = simulate(MODEL, time_s, u, parameters={"inertia": 1.5}, **given)
    assert with_effect.outputs == pytest.approx(with_value.outputs, abs=1e-12)


def test_a_function_that_makes_a_model_is_a_source():
    assert load_model(f"{__name__}:make") is MODEL


def test_a_site_in_unknown_names_is_an_error():
    with pytest.raises(ModelError, match="rate = 'spede': unknown name 'spede'"):
        python_model(
            "m", derivative=derivative, output=output, states=["angle", "speed"], outputs=["y"],
            sites=[Site("hinge", "joint", "angle", "spede")],
        )  # fmt: skip
