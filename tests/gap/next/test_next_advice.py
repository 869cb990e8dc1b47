"""What is advised where no trial inside the limits separates two causes."""

from types import SimpleNamespace

import pytest

from labrun.gap.diagnosis import Name
from labrun.gap.next.proposal import would_separate
from labrun.gap.next.rivals import NOTHING


def _rival(effect, kind="effect"):
    """Return an explanation of which the cause and its sizes matter here."""
    cause = None if effect is None else Name(effect, "hinge" if kind == "effect" else effect, kind)
    words = NOTHING if cause is None else cause.words
    return SimpleNamespace(words=words, cause=cause, sizes={})


@pytest.mark.parametrize(
    "other",
    [_rival("constant-force"), _rival("bias"), _rival("asymmetric-stiffness"), _rival("tilt", "parameter")],
)
def test_what_pulls_to_one_side_is_told_from_asymmetric_friction_by_gravity_from_the_other_side(other):
    for pair in ((_rival("asymmetric-friction"), other), (other, _rival("asymmetric-friction"))):
        assert "two orientations of gravity" in would_separate(*pair)


def test_a_tilt_is_told_from_a_constant_force_by_gravity_from_the_other_side():
    assert "two orientations of gravity" in would_separate(
        _rival("constant-force"), _rival("tilt", "parameter")
    )


@pytest.mark.parametrize("other", ["stribeck-friction", "viscous-damping", "load-dependent-friction"])
def test_what_resists_both_directions_alike_is_told_from_asymmetric_friction_by_mirror_images(other):
    assert "mirror images" in would_separate(_rival(other), _rival("asymmetric-friction"))


def test_coulomb_friction_is_the_asymmetric_one_without_asymmetry():
    advice = would_separate(_rival("coulomb-friction"), _rival("asymmetric-friction"))
    assert advice.startswith(
        "Coulomb friction at hinge or asymmetric friction at hinge: The richer friction contains"
    )


def test_beside_recalibration_alone_more_repeats_are_advised():
    assert "More repeats" in would_separate(_rival("asymmetric-friction"), _rival(None))
