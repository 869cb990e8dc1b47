"""A condition as a key and in words."""

import pytest

from labrun.experiment import condition_key, condition_text, value_text, varying
from labrun.experiment.raw import condition_units


def test_equal_conditions_have_equal_keys_whatever_their_order() -> None:
    assert condition_key({"a": 1, "fin": "soft"}) == condition_key({"fin": "soft", "a": 1.0})
    assert condition_key({"a": 1.0}) != condition_key({"a": 2.0})


def test_a_condition_reads_as_a_person_writes_it() -> None:
    condition = {"a": 20.0, "f": 1.23456, "fin": "soft"}
    assert condition_text(condition) == "a = 20, f = 1.23456, fin = soft"
    assert (
        condition_text(condition, {"a": "deg", "f": "Hz", "fin": "1"}, digits=3)
        == "a = 20 deg, f = 1.23 Hz, fin = soft"
    )
    assert condition_text({}) == ""


def test_a_value_without_unit_is_a_bare_number() -> None:
    assert value_text(0.3, "1") == "0.3"
    assert value_text(0.3, "Hz") == "0.3 Hz"
    assert value_text("soft", "Hz") == "soft"


def test_only_what_differs_between_conditions_names_them() -> None:
    assert varying([{"a": 1, "b": 2, "c": "x"}, {"a": 1, "b": 3, "c": "y"}]) == ["b", "c"]
    assert varying([{"a": 1, "b": 2}]) == ["a", "b"]


@pytest.mark.parametrize(
    ("key", "expression", "unit"),
    [
        ("frequency_hz", "f", "Hz"),
        ("offset_deg", "-f", "deg"),
        ("offset_deg", "f / 2", None),
        ("phase_deg", " f ", "deg"),
    ],
)
def test_a_condition_has_the_unit_of_the_key_that_takes_it_as_it_stands(
    key: str, expression: str, unit: str | None
) -> None:
    data = {
        "kind": "sweep",
        "sweep": {"axes": {"f": [1, 2]}},
        "gait": {"joints": {"tail": {key: expression}}},
    }
    assert condition_units(data).get("f") == unit


def test_the_table_of_units_counts_before_the_keys_and_keys_that_disagree_say_nothing() -> None:
    joints = {"tail": {"frequency_hz": "f", "offset_deg": "f", "amplitude_deg": "a"}}
    data = {"kind": "sweep", "sweep": {"axes": {"f": [1], "a": [1], "v": [1]}}, "gait": {"joints": joints}}
    assert condition_units(data) == {"a": "deg"}
    data |= {"units": {"f": "rpm"}, "trial": {"carriage": {"speed_m_s": "v"}}}
    assert condition_units(data) == {"f": "rpm", "a": "deg", "v": "m/s"}
