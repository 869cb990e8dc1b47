"""A diagnosis with a model of the user's own in MuJoCo: what is missing is found around it as around equations."""

from pathlib import Path

import pytest

from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.models import load_model

from .benches import TRUE, dry_friction, recorded

ARM_M, GRAVITY_M_S2 = 0.1, 9.81
MASS_KG = TRUE["gravity"] / GRAVITY_M_S2 / ARM_M
SPIN_KG_M2 = TRUE["inertia"] - MASS_KG * ARM_M**2
MJCF = f"""
<mujoco>
  <option gravity="0 0 -{GRAVITY_M_S2}"/>
  <worldbody>
    <body name="arm">
      <joint name="hinge" axis="0 1 0" stiffness="0.068" damping="0.001"/>
      <inertial pos="0 0 -{ARM_M}" mass="{1.02 * MASS_KG}" diaginertia="{SPIN_KG_M2} {SPIN_KG_M2} {SPIN_KG_M2}"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
</mujoco>
"""
TABLE = """
name   = "arm"
mujoco = "arm.xml"
[states]
angle = "joint.hinge.position"
rate  = "joint.hinge.velocity"
[inputs]
torque = { mjcf = "actuator.motor", unit = "N m", between = "linear" }
[parameters]
mass      = { mjcf = "body.arm.mass", tolerance = 0.05, unit = "kg", lower = 1e-3 }
stiffness = { mjcf = "joint.hinge.stiffness", tolerance = "free", unit = "N m/rad" }
damping   = { mjcf = "joint.hinge.damping", tolerance = "free", unit = "N m s/rad" }
[outputs]
angle = { mjcf = "joint.hinge.position", unit = "rad" }
[sites.hinge]
kind = "joint"
stiffness = "stiffness"
[initial]
angle = 0.0
rate = 0.0
"""


@pytest.mark.slow
def test_dry_friction_is_found_in_a_joint_of_mujocos(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(MJCF)
    (tmp_path / "arm.toml").write_text(TABLE)
    dataset = diagnose_dataset(
        recorded(dry_friction(0.006)), load_model(tmp_path / "arm.toml"), Options(workers=2)
    )
    assert dataset.verdict == "explained"
    assert str(dataset.causes[0].name) in ("coulomb-friction at hinge", "stribeck-friction at hinge")
    assert dataset.causes[0].values["torque"].value == pytest.approx(0.006, rel=0.1)
    assert dataset.gap.after < 0.2 * dataset.gap.recalibrated
