import dataclasses
import math

import numpy as np
import pytest
from rig import MODEL, SITES, named

from labrun.effects import AttachedEffect, Scale, effects, load_effect
from labrun.errors import ModelError, PluginError
from labrun.models import parse_model, simulate

TIME = np.linspace(0, 3, 151)
DRIVE = np.column_stack([5 * np.sin(4 * TIME) + np.sign(np.sin(2 * TIME)), np.cos(TIME)])
PLAIN = simulate(MODEL, TIME, DRIVE, substeps=4)
LABELS = [f"{effect.id}-{effect.kind}" for effect in effects()]


@pytest.mark.parametrize("effect", effects(), ids=LABELS)
@pytest.mark.parametrize("between", ["linear", "hold"])
def test_an_effect_vanishes_at_its_neutral_value(effect, between):
    model = MODEL.with_between({"torque": between})
    neutral = [
        parameter.starts[0] if parameter.neutral is None else parameter.neutral
        for parameter in effect.parameters
    ]
    attached = AttachedEffect(effect, SITES[effect.kind], tuple(neutral))
    plain = simulate(model, TIME, DRIVE, substeps=4)
    assert simulate(model, TIME, DRIVE, effects=[attached], substeps=4).outputs == pytest.approx(
        plain.outputs, abs=1e-12
    )


@pytest.mark.parametrize("effect", effects(), ids=LABELS)
def test_an_effect_shows_from_every_start(effect):
    scale = Scale(
        coordinate=0.3, rate=2.0, acceleration=10.0, force=10.0, signal=5.0 if effect.kind == "input" else 0.3
    )
    count = max(len(parameter.starts) for parameter in effect.parameters)
    for index in range(count):
        values = [
            parameter.start_values(scale)[min(index, len(parameter.starts) - 1)]
            for parameter in effect.parameters
        ]
        for parameter, value in zip(effect.parameters, values, strict=True):
            low, high = parameter.bounds(scale)
            assert low <= value <= high or (parameter.instead_of and value == 0.0)  # not chosen
        attached = AttachedEffect(effect, SITES[effect.kind], tuple(values))
        moved = simulate(MODEL, TIME, DRIVE, effects=[attached], substeps=4)
        assert moved.finite
        shows = np.max(np.abs(moved.outputs - PLAIN.outputs)) > 1e-3
        # a level that this drive does not reach: its further starts are for others
        assert shows or (index > 0 and effect.parameters[0].neutral == math.inf)


@pytest.mark.parametrize("effect", effects(), ids=LABELS)
def test_an_effect_says_what_it_is(effect):
    assert effect.title.endswith(".")
    assert len(effect.form) > 5
    assert len(effect.source) > 20
    for parameter in effect.parameters:
        assert parameter.unit("rad", "V")
        assert parameter.unit("m", "V") != ""
        assert parameter.lower < parameter.upper
        assert not math.isnan(parameter.neutral if parameter.neutral is not None else 0.0)


def test_units_follow_the_site():
    (torque, speed, presliding) = load_effect("coulomb-friction").parameters
    assert (torque.name, torque.unit("rad"), torque.unit("m"), torque.unit("V")) == (
        "torque",
        "N m",
        "N",
        "force",
    )
    assert (speed.held, speed.unit("m")) == (True, "m/s")
    assert (presliding.instead_of, presliding.unit("rad")) == (speed.name, "rad")


def test_an_effect_sits_only_where_the_site_gives_what_it_needs():
    offset = load_effect("rest-offset")
    hinge, blade, *_ = MODEL.sites
    assert offset.fits(hinge)
    assert not offset.fits(blade)
    soft = parse_model(_without_stiffness(), "soft.toml")
    assert not offset.fits(soft.sites[0])
    with pytest.raises(ModelError, match=r"needs the stiffness at site hinge.*\n.*\[sites.hinge\]"):
        simulate(soft, TIME, DRIVE, effects=[offset.attach("hinge")], substeps=1)


def _without_stiffness() -> str:
    from rig import JOINT

    return JOINT.replace('stiffness = "stiffness"\n', "")


def test_wrong_places_and_values_are_errors():
    with pytest.raises(ModelError, match=r"no joint site 'hing'(.|\n)*did you mean .hinge."):
        simulate(MODEL, TIME, DRIVE, effects=[named("coulomb-friction", site="hing")], substeps=1)
    with pytest.raises(ModelError, match="no parameter 'torqe'"):
        named("coulomb-friction", torqe=1.0)
    broken = dataclasses.replace(named("coulomb-friction"), values=(math.nan, 0.1, 0.0))
    with pytest.raises(ModelError, match="torque is not a number"):
        simulate(MODEL, TIME, DRIVE, effects=[broken], substeps=1)
    with pytest.raises(ModelError, match="takes torque, transition_speed, presliding; 1 values"):
        simulate(MODEL, TIME, DRIVE, effects=[named("coulomb-friction").with_values([1.0])], substeps=1)


def test_an_id_at_two_kinds_of_sites_needs_the_kind():
    with pytest.raises(ModelError, match='for input, output sites: say which, as kind = "input"'):
        load_effect("delay")
    with pytest.raises(ModelError, match="sits at input, output sites, not at a joint site"):
        load_effect("delay", "joint")
    with pytest.raises(PluginError, match=r"gives module, not labrun\.effects\.Effect"):
        load_effect("os:path")
