"""What the diagnosis says of recordings that others made, two of which have published answers."""

from pathlib import Path

import pytest
from diagnosing import diagnose

from labrun.gap.diagnose import Options
from labrun.gap.diagnosis import Cause, Diagnosis

pytestmark = pytest.mark.slow


def said(recording: Path) -> Diagnosis:
    return diagnose(recording, options=Options(places=False, workers=2))


def effects(cause: Cause) -> set[str]:
    """Return the effects a cause may be."""
    return {cause.name.effect, *(one.effect for one in cause.indistinguishable_from)}


def test_the_drive_has_the_published_dry_friction_and_an_offset(recordings: Path) -> None:
    found = said(recordings / "emps")
    assert found.verdict == "explained"
    offset, friction = sorted(found.causes, key=lambda one: "coulomb-friction" in effects(one))
    assert "constant-force" in effects(offset)
    assert friction.values["torque"].value == pytest.approx(20.3, rel=0.1)
    assert found.shrinkage is not None
    assert found.shrinkage.value > 0.95


def test_the_circuit_has_the_published_cubic_stiffness_and_an_offset(recordings: Path) -> None:
    found = said(recordings / "silverbox")
    assert found.verdict == "explained"
    cubic, offset = sorted(found.causes, key=lambda one: "cubic-stiffness" not in effects(one))
    assert cubic.name.effect == "cubic-stiffness"
    assert "constant-force" in effects(offset)
    assert found.gap.after < 0.05 * found.gap.recalibrated


def test_the_swinging_arm_has_dry_friction_and_drag(recordings: Path) -> None:
    found = said(recordings / "ring-down")
    assert set().union(*map(effects, found.causes)) >= {"coulomb-friction", "quadratic-drag"}
    assert found.shrinkage is not None
    assert found.shrinkage.value > 0.8


def test_the_geared_servo_has_friction_that_grows_with_its_load(recordings: Path) -> None:
    found = said(recordings / "xl330-servo")
    assert found.verdict == "explained"
    assert "load-dependent-friction" in effects(found.causes[0])
    assert found.causes[0].name.site == "shaft"
    assert found.shrinkage is not None
    assert found.shrinkage.value > 0.9
