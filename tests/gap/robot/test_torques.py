"""Robots diagnosed by the torques in their logs, against arms whose truth is known."""

import json

import numpy as np
import pytest

from labrun.models import read_robot
from tests.gap.robot.torque_logs import Hidden, arm, causes_of, diagnosed


def friction(*levels):
    return lambda q, rate: -np.array(levels) * np.sign(rate)


def test_an_arm_with_nothing_hidden_is_blamed_for_nothing(tmp_path):
    diagnosis = diagnosed(tmp_path, 4, Hidden())
    assert causes_of(diagnosis) == {}
    assert diagnosis.headline == ()


@pytest.mark.parametrize("seed", [1, 2])
def test_masses_within_their_tolerance_are_no_cause(tmp_path, seed):
    masses = 1.0 + 0.05 * np.random.default_rng(seed).standard_normal(2)
    assert causes_of(diagnosed(tmp_path, 2, Hidden(masses=tuple(masses)), seed=seed)) == {}


def test_dry_friction_is_named_at_its_joints_with_its_size(tmp_path):
    causes = causes_of(diagnosed(tmp_path, 4, Hidden(force=friction(0.8, 0.0, 0.4, 0.2))))
    assert set(causes) == {("coulomb-friction", f"arm_{number}") for number in (1, 3, 4)}
    for number, level in ((1, 0.8), (3, 0.4), (4, 0.2)):
        assert causes["coulomb-friction", f"arm_{number}"].values["torque"].value == pytest.approx(
            level, rel=0.08
        )


def test_a_joint_may_have_more_than_one_cause(tmp_path):
    def force(q, rate):
        return np.column_stack([-0.6 * np.sign(rate[:, 0]) - 0.4 * rate[:, 0], 0.7 + 0.0 * q[:, 1]])

    causes = causes_of(diagnosed(tmp_path, 2, Hidden(force=force)))
    assert set(causes) == {
        ("coulomb-friction", "arm_1"), ("viscous-damping", "arm_1"), ("constant-force", "arm_2")
    }  # fmt: skip
    assert causes["viscous-damping", "arm_1"].values["coefficient"].value == pytest.approx(0.4, rel=0.1)
    assert causes["constant-force", "arm_2"].values["force"].value == pytest.approx(0.7, rel=0.1)


def test_the_inertia_of_a_rotor_is_named_at_its_joint(tmp_path):
    causes = causes_of(diagnosed(tmp_path, 2, Hidden(armature=(0.0, 0.08))))
    assert set(causes) == {("added-inertia", "arm_2")}
    assert causes["added-inertia", "arm_2"].values["inertia"].value == pytest.approx(0.08, rel=0.15)


def test_a_force_that_is_periodic_in_the_position_is_named_with_its_period(tmp_path):
    def cogging(q, rate):
        return np.column_stack([0.0 * q[:, 0], -0.4 * np.sin(12.0 * q[:, 1])])

    causes = causes_of(diagnosed(tmp_path, 2, Hidden(force=cogging)))
    assert set(causes) == {("cogging", "arm_2")}
    assert causes["cogging", "arm_2"].values["periods"].value == pytest.approx(12.0, rel=0.05)


def test_a_load_is_told_first_with_its_mass_and_place_and_joints_with_it(tmp_path):
    hidden = Hidden(load=(0.5, (0.03, 0.0, 0.1)), force=friction(0.8, 0.0, 0.4, 0.0))
    diagnosis = diagnosed(tmp_path, 4, hidden)
    causes = causes_of(diagnosis)
    assert set(causes) == {
        ("payload", "link_4"),
        ("coulomb-friction", "arm_1"),
        ("coulomb-friction", "arm_3"),
    }
    load = causes["payload", "link_4"].values
    assert load["mass"].value == pytest.approx(0.5, rel=0.2)
    assert diagnosis.sentence.startswith("the robot carries")


def test_a_current_with_the_opposite_sign_is_told(tmp_path):
    diagnosis = diagnosed(
        tmp_path, 4, Hidden(units=(1.0, 1.0, -1.0, 1.0), force=friction(0.8, 0.0, 0.4, 0.0))
    )
    assert "joint arm_3 is reported with the opposite sign" in diagnosis.headline
    causes = causes_of(diagnosis)
    assert set(causes) == {("coulomb-friction", "arm_1"), ("coulomb-friction", "arm_3")}
    assert causes["coulomb-friction", "arm_3"].values["torque"].value == pytest.approx(0.4, rel=0.1)


def test_motor_currents_are_told_with_what_one_unit_is(tmp_path):
    hidden = Hidden(units=(0.1, 0.12, -0.2, 0.3), force=friction(0.8, 0.8, 0.4, 0.2))
    diagnosis = diagnosed(tmp_path, 4, hidden)
    assert any("motor currents" in sentence for sentence in diagnosis.headline)
    assert "joint arm_3 is reported with the opposite sign" in diagnosis.headline
    causes = causes_of(diagnosis)
    assert set(causes) == {("coulomb-friction", f"arm_{number}") for number in (1, 2, 3, 4)}
    assert causes["coulomb-friction", "arm_1"].values["torque"].value == pytest.approx(0.8, rel=0.2)


def test_a_joint_whose_motor_current_is_logged_is_told_its_torque_per_ampere(tmp_path):
    hidden = Hidden(units=(0.1, -1.0), amperes=(0,), force=friction(0.8, 0.0))
    diagnosis = diagnosed(tmp_path, 2, hidden)
    constant, sign = diagnosis.headline
    assert constant.startswith("the torque of joint arm_1 is a motor current: ")
    assert float(constant.split(": ")[1].split()[0]) == pytest.approx(10.0, rel=0.1)
    assert sign == "joint arm_2 is reported with the opposite sign"
    causes = causes_of(diagnosis)
    assert set(causes) == {("coulomb-friction", "arm_1")}
    assert causes["coulomb-friction", "arm_1"].values["torque"].value == pytest.approx(0.8, rel=0.1)


def test_a_channel_without_torque_is_told_dead_and_its_joint_is_not_blamed(tmp_path):
    diagnosis = diagnosed(tmp_path, 2, Hidden(units=(1.0, 0.0), force=friction(0.8, 0.0)))
    assert any("arm_2: its torque is 0 throughout" in remark for remark in diagnosis.remarks)
    assert set(causes_of(diagnosis)) == {("coulomb-friction", "arm_1")}


def test_the_answer_is_json_and_says_which_low_pass_was_taken(tmp_path):
    diagnosis = diagnosed(tmp_path, 2, Hidden(force=friction(0.8, 0.4)), trials=3, seconds=6.0)
    loads = json.loads(json.dumps(diagnosis.to_json()))
    assert {cause["effect"] for cause in loads["causes"]} == {"coulomb-friction"}
    assert loads["joints"][0]["error_unit"] == "N m"
    assert any("low-passed at" in note for note in loads["notes"])


def test_only_robots_whose_drives_are_all_told_torques_are_diagnosed_by_them(tmp_path):
    by_torque, by_goal = tmp_path / "torque.xml", tmp_path / "goal.xml"
    by_torque.write_text(arm(2), encoding="utf-8")
    by_goal.write_text(arm(2).replace("<motor", '<position kp="10"', 1), encoding="utf-8")
    assert read_robot(by_torque).is_told_torques
    assert not read_robot(by_goal).is_told_torques
