"""References over time."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun import registry
from labrun.control.making import REFERENCES, make_reference
from labrun.control.references import TableReference
from labrun.errors import SpecError
from labrun.toml import PluginTable

TIMES = st.floats(0, 1000)


def reference(plugin, condition=None, **settings):
    return make_reference("force", PluginTable(plugin=plugin, **settings), condition or {})


@given(TIMES)
def test_each_reference_is_its_formula(t):
    assert reference("constant", value=0.3)(t) == 0.3
    assert reference("step", before=1.0, after=2.0, at_s=5.0)(t) == (2.0 if t >= 5 else 1.0)
    assert reference("sine", mean=1.0, amplitude=2.0, period_s=8.0, phase_deg=90.0)(t) == pytest.approx(
        1 + 2 * math.cos(2 * math.pi * t / 8), abs=1e-9
    )
    ramp = reference("ramp", **{"from": 1.0, "to": 3.0, "from_s": 10.0, "to_s": 20.0})
    assert ramp(t) == pytest.approx(float(np.interp(t, [10, 20], [1, 3])))
    formula = reference("formula", {"level": 0.5}, value="level + 0.1 * sin(t)")
    assert formula(t) == pytest.approx(0.5 + 0.1 * math.sin(t))


@given(TIMES)
def test_the_half_sine_has_the_arches_of_equation_5_2(t):
    arch = reference("half-sine", low=20.0, high=60.0, period_s=100.0)(t)
    assert arch == pytest.approx(20 + abs(40 * math.sin(2 * math.pi * 0.005 * t)), abs=1e-9)
    assert 20 - 1e-9 <= arch <= 60 + 1e-9


def test_a_table_is_straight_between_its_points_and_held_outside(tmp_path):
    (tmp_path / "waves.csv").write_text("time_s,force_n\n0,0.2\n10,0.4\n30,0.3\n")
    embedded = TableReference.embed({"file": "waves.csv"}, lambda name: tmp_path / name)
    assert embedded == {"points": [[0.0, 0.2], [10.0, 0.4], [30.0, 0.3]]}
    table = reference("table", **embedded)
    assert [table(t) for t in (-1.0, 5.0, 20.0, 99.0)] == pytest.approx([0.2, 0.3, 0.35, 0.3])


def test_a_table_that_does_not_hold_says_where(tmp_path):
    (tmp_path / "bad.csv").write_text("0,1\n1,two\n")
    with pytest.raises(SpecError, match="row 2"):
        TableReference.embed({"file": "bad.csv"}, lambda name: tmp_path / name)
    with pytest.raises(SpecError, match="times ascend"):
        reference("table", points=[[0.0, 1.0], [0.0, 2.0]])


def test_a_setting_may_be_an_expression_in_the_condition():
    assert reference("constant", {"level": 2.0}, value="3 * level")(0.0) == 6.0


def test_a_wrong_key_names_loop_and_plugin():
    with pytest.raises(SpecError, match="reference of loop force"):
        reference("half-sine", low=0.1, high=0.2)


def test_every_installed_reference_says_its_keys():
    assert {"constant", "step", "ramp", "sine", "half-sine", "formula", "table"} <= set(
        registry.names(REFERENCES)
    )
    for name in registry.names(REFERENCES):
        assert registry.load(REFERENCES, name).Settings.model_fields
