"""Which name a person meant."""

import pytest

from labrun.toml import nearest


@pytest.mark.parametrize(
    ("name", "known", "meant"),
    [
        ("forse_x", ["force_x", "torque_z"], "force_x"),
        ("Force_X", ["force_x", "torque_z"], "force_x"),
        ("freq", ["a", "f"], "f"),
        ("banana", ["force_x", "torque_z"], None),
        ("anything", [], None),
    ],
)
def test_the_name_most_alike_is_meant_whatever_its_case_or_none(name, known, meant):
    assert nearest(name, known) == meant


def test_how_much_alike_it_has_to_be_can_be_said():
    ports = ["/dev/ttyACM0"]
    assert nearest("/dev/ttyUSB0", ports) == ports[0]
    assert nearest("/dev/ttyUSB0", ports, cutoff=0.95) is None
