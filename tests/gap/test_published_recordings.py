"""What the diagnosis says of recordings that others made, two of which have published answers."""

from pathlib import Path

import pytest
from diagnosing import diagnose

from labrun.gap.diagnose import Options
from labrun.gap.diagnosis import Cause, Diagnosis

pytestmark = pytest.mark.slow


def diagnosed(recording: Path) -> Diagnosis:
    return diagnose(recording, options=Options(places=False, workers=2))


def effects(cause: Cause) -> set[str]:
    """Return the effects a cause may be."""
    return {cause.name.effect, *(rival.effect for rival in cause.rivals)}


DRY = {"coulomb-friction", "stribeck-friction", "asymmetric-friction"}


def test_the_drive_has_the_published_dry_friction_which_differs_by_direction(recordings: Path) -> None:
    result = diagnosed(recordings / "emps")
    friction = next(cause for cause in result.causes if effects(cause) & DRY)
    assert friction.values["torque"].value == pytest.approx(20.3, rel=0.1)
    assert set().union(*map(effects, result.causes)) & {"asymmetric-friction", "constant-force"}
    assert result.shrinkage is not None
    assert result.shrinkage.value > 0.95


def test_the_circuit_has_the_published_cubic_stiffness_and_an_offset(recordings: Path) -> None:
    result = diagnosed(recordings / "silverbox")
    assert result.verdict == "explained"
    cubic, offset = sorted(result.causes, key=lambda cause: "cubic-stiffness" not in effects(cause))
    assert cubic.name.effect == "cubic-stiffness"
    assert "constant-force" in effects(offset)
    assert result.gap.after < 0.05 * result.gap.recalibrated


def test_the_swinging_arm_has_dry_friction_and_drag(recordings: Path) -> None:
    result = diagnosed(recordings / "ring-down")
    everything = set().union(*map(effects, result.causes))
    assert everything & DRY
    assert "quadratic-drag" in everything
    assert result.shrinkage is not None
    assert result.shrinkage.value > 0.8


def test_the_geared_servo_has_friction_that_grows_with_its_load(recordings: Path) -> None:
    result = diagnosed(recordings / "xl330-servo")
    assert "load-dependent-friction" in effects(result.causes[0])
    assert result.causes[0].name.site == "shaft"
    assert result.shrinkage is not None
    assert result.shrinkage.value > 0.85


def test_the_servo_at_its_stop_has_one_end_only(recordings: Path) -> None:
    stop = diagnosed(recordings / "so101-wrist").causes[0]
    assert stop.name.effect == "end-stop"
    assert stop.values["lower"].value == pytest.approx(-1.02, abs=0.03)
    assert "upper" not in stop.values


def test_the_servo_that_sticks_has_dry_friction_play_or_hysteresis(recordings: Path) -> None:
    (cause,) = diagnosed(recordings / "so101-pan").causes
    assert effects(cause) & {"backlash", "dead-band", "hysteresis", "presliding-friction", *DRY}


def test_the_robot_joint_has_the_published_dry_friction(recordings: Path) -> None:
    result = diagnosed(recordings / "tx40-forearm")
    assert result.causes[0].name.effect == "coulomb-friction"
    assert result.causes[0].values["torque"].value * 48 == pytest.approx(2.48, rel=0.15)


def test_the_seal_rubs_in_proportion_to_its_pressure(recordings: Path) -> None:
    result = diagnosed(recordings / "o-ring")
    (seal,) = (cause for cause in result.causes if "load-dependent-friction" in effects(cause))
    bore_m2 = 4.9087e-4
    per_bar = seal.values["coefficient"].value * bore_m2 * 1e5
    published = (15.62 - 7.84) / 2 / 6  # half the difference between directions, over 6 bar
    assert per_bar == pytest.approx(published, rel=0.15)
