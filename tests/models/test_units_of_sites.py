"""A site knows the unit of its coordinate by what the model says, in an order that a person can follow."""

import pytest

from labrun.models import parse_model

MODEL = """
name = "slide"
states = ["way", "speed"]
[inputs]
push = {{ unit = "N" }}
[parameters]
spring = {{ value = 3.0, unit = "{spring}" }}
[equations]
way = "speed"
speed = "force.slide + push - spring*way"
[outputs]
seen = {{ equation = "way", unit = "V" }}
{output}
[sites.slide]
kind = "{kind}"
coordinate = "way"
rate = "speed"
stiffness = "spring"
{said}
[initial]
way = 0.0
speed = 0.0
"""


@pytest.mark.parametrize(
    ("message", "output", "spring", "kind", "unit"),
    [
        ('unit = "m"', 'way = { equation = "way", unit = "rad" }', "N m/rad", "joint", "m"),
        ("", 'way = { equation = "way", unit = "m" }', "N m/rad", "joint", "m"),
        ("", 'encoder = { equation = "way", unit = "m" }', "N m/rad", "joint", "m"),
        ("", 'speed = { equation = "speed", unit = "m/s" }', "1/s^2", "joint", "m"),
        ("", "", "N/m", "joint", "m"),
        ("", "", "N m/rad", "body", "rad"),
        ("", "", "1/s^2", "joint", "rad"),
        ("", "", "1/s^2", "body", "m"),
    ],
    ids=[
        "said",
        "output",
        "output by another name",
        "rate",
        "spring",
        "spring of a body",
        "a joint turns",
        "a body moves",
    ],
)
def test_the_unit_is_said_or_shown_or_that_of_the_spring_or_of_the_kind(message, output, spring, kind, unit):
    model = parse_model(MODEL.format(said=message, output=output, spring=spring, kind=kind), "slide.toml")
    assert model.coordinate_unit(model.site_named("slide")) == unit


def test_a_coordinate_that_is_an_input_has_the_unit_of_its_recording():
    model = parse_model(
        MODEL.replace('states = ["way", "speed"]', "states = []")
        .replace("[inputs]", '[inputs]\nway = {{ unit = "1" }}')
        .replace('way = "speed"\nspeed = "force.slide + push - spring*way"\n', "")
        .replace('equation = "way", unit = "V"', 'equation = "push - spring*way + force.slide", unit = "N"')
        .replace("[initial]\nway = 0.0\nspeed = 0.0\n", "")
        .replace('rate = "speed"\n', 'rate = "0*way"\n')
        .format(said="", output="", spring="1/s^2", kind="joint"),
        "slide.toml",
    )
    assert model.coordinate_unit(model.site_named("slide"), {"way": "m"}) == "m"
