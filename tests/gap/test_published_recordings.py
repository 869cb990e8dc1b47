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
    return {cause.name.effect, *(rival.effect for rival in cause.rivals)}


def test_the_drive_has_the_published_dry_friction_and_an_offset(recordings: Path) -> None:
    result = said(recordings / "emps")
    assert result.verdict == "explained"
    offset, friction = sorted(result.causes, key=lambda cause: "coulomb-friction" in effects(cause))
    assert "constant-force" in effects(offset)
    assert friction.values["torque"].value == pytest.approx(20.3, rel=0.1)
    assert result.shrinkage is not None
    assert result.shrinkage.value > 0.95


def test_the_circuit_has_the_published_cubic_stiffness_and_an_offset(recordings: Path) -> None:
    result = said(recordings / "silverbox")
    assert result.verdict == "explained"
    cubic, offset = sorted(result.causes, key=lambda cause: "cubic-stiffness" not in effects(cause))
    assert cubic.name.effect == "cubic-stiffness"
    assert "constant-force" in effects(offset)
    assert result.gap.after < 0.05 * result.gap.recalibrated


def test_the_swinging_arm_has_dry_friction_and_drag(recordings: Path) -> None:
    result = said(recordings / "ring-down")
    assert set().union(*map(effects, result.causes)) >= {"coulomb-friction", "quadratic-drag"}
    assert result.shrinkage is not None
    assert result.shrinkage.value > 0.8


def test_the_geared_servo_has_friction_that_grows_with_its_load(recordings: Path) -> None:
    result = said(recordings / "xl330-servo")
    assert result.verdict == "explained"
    assert "load-dependent-friction" in effects(result.causes[0])
    assert result.causes[0].name.site == "shaft"
    assert result.shrinkage is not None
    assert result.shrinkage.value > 0.85


def test_the_servo_at_its_stop_has_one_end_only(recordings: Path) -> None:
    stop = said(recordings / "so101-wrist").causes[0]
    assert stop.name.effect == "end-stop"
    assert stop.values["lower"].value == pytest.approx(-1.02, abs=0.03)
    assert "upper" not in stop.values


def test_the_servo_that_sticks_has_dry_friction_or_play(recordings: Path) -> None:
    causes = said(recordings / "so101-pan").causes
    assert [cause.name.effect for cause in causes] == ["coulomb-friction"]
    assert "backlash" in effects(causes[0])


def test_the_robot_joint_has_the_published_dry_friction(recordings: Path) -> None:
    result = said(recordings / "tx40-forearm")
    assert result.causes[0].name.effect == "coulomb-friction"
    assert result.causes[0].values["torque"].value * 48 == pytest.approx(2.48, rel=0.15)


def test_the_seal_rubs_in_proportion_to_its_pressure(recordings: Path) -> None:
    result = said(recordings / "o-ring")
    (seal,) = (cause for cause in result.causes if "load-dependent-friction" in effects(cause))
    bore_m2 = 4.9087e-4
    per_bar = seal.values["coefficient"].value * bore_m2 * 1e5
    published = (15.62 - 7.84) / 2 / 6  # half the difference between directions, over 6 bar
    assert per_bar == pytest.approx(published, rel=0.15)
