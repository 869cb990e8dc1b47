"""A condition as a key and in words."""

from labrun.spec import condition_key, condition_text, value_text, varying


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
