"""Numbers of another tool: which the log asks for, and which stand in for something else."""

import json

import pytest
from test_file_check import FRICTION, diagnosis, logged

from labrun.app.other_fits import read_fit
from labrun.errors import RequestError
from labrun.gap import FittedValue, judge_fit
from labrun.models import read_robot

CAUSE = {"effect": "coulomb-friction", "kind": "effect", "site": "elbow"}


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    from test_file_check import XML

    file = tmp_path_factory.mktemp("robot") / "arm.xml"
    file.write_text(XML)
    return read_robot(file)


def numbers(values):
    """Return quantities by element and name."""
    return {(value.element, value.quantity): value.value for value in values}


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return logged(tmp_path_factory.mktemp("log"), 0.4)


def test_damping_where_friction_is_stands_in_for_friction_and_a_needless_number_is_not_asked_for(log):
    robot, model, dataset = log
    results = [FittedValue("elbow", "damping", 0.9), FittedValue("shoulder", "armature", 0.0515)]
    fit = judge_fit(robot, model, dataset, diagnosis({}, {}, [FRICTION], [CAUSE]), results)
    damping, armature = fit.values
    assert damping.judgement == "stands in"
    assert damping.instead == "Coulomb friction at elbow"
    assert armature.judgement == "not asked for"
    elbow = fit.joints[1]
    assert elbow.corrected < 0.5 * elbow.fitted < elbow.stated


def test_the_friction_that_is_there_holds(log):
    robot, model, dataset = log
    results = [FittedValue("elbow", "frictionloss", 0.39)]
    fit = judge_fit(robot, model, dataset, diagnosis({}, {}, [FRICTION], [CAUSE]), results)
    assert [value.judgement for value in fit.values] == ["holds"]
    assert fit.values[0].without == pytest.approx(fit.joints[1].stated)


def test_a_plain_table_is_read(tmp_path, robot):
    (tmp_path / "fit.json").write_text(
        json.dumps({"elbow": {"armature": 0.03, "damping": 0.4}, "lower": {"mass": 0.9}})
    )
    assert numbers(read_fit(tmp_path / "fit.json", robot)) == {
        ("elbow", "armature"): 0.03, ("elbow", "damping"): 0.4, ("lower", "mass"): 0.9,
    }  # fmt: skip


def test_parameters_of_mujoco_sysid_are_read_with_their_bounds(tmp_path, robot):
    yaml = pytest.importorskip("yaml")
    # what mujoco.sysid.ParameterDict.save_to_disk writes: the state of every parameter by its name
    message = {
        name: {"name": name, "nominal": [nominal], "min_value": [low], "max_value": [high], "value": [value]}
        for name, nominal, low, high, value in (
            ("elbow_armature", 0.02, 0.0, 0.1, 0.03),
            ("lower_mass", 0.8, 0.4, 1.2, 1.2),
        )
    }
    (tmp_path / "params_x_hat.yaml").write_text(yaml.safe_dump(message))
    values = read_fit(tmp_path / "params_x_hat.yaml", robot)
    assert numbers(values) == {("elbow", "armature"): 0.03, ("lower", "mass"): 1.2}
    assert {value.element: value.at_bound for value in values} == {"elbow": False, "lower": True}


def test_lists_in_the_order_of_joints_are_read_and_a_delay_in_steps_becomes_seconds(tmp_path, robot):
    pace = {
        "joint_order": ["elbow", "shoulder"], "armature": [0.03, 0.06], "viscous_friction": [0.1, 0.2],
        "static_friction": [0.3, 0.4], "delay": 5,
    }  # fmt: skip
    (tmp_path / "fit.json").write_text(json.dumps(pace))
    result = numbers(read_fit(tmp_path / "fit.json", robot))
    assert result["elbow", "armature"] == 0.03
    assert result["shoulder", "frictionloss"] == 0.4
    assert result["elbow", "delay"] == pytest.approx(0.005)


def test_actuators_of_isaac_lab_are_read_by_their_patterns(tmp_path, robot):
    legs = {
        "joint_names_expr": [".*"],
        "stiffness": {"el.*": 42.0, ".*": 160.0},
        "damping": 2.0,
        "armature": 0.01,
    }
    (tmp_path / "fit.json").write_text(json.dumps({"actuators": {"arm": legs}}))
    result = numbers(read_fit(tmp_path / "fit.json", robot))
    assert (result["elbow", "kp"], result["shoulder", "kp"]) == (42.0, 160.0)
    assert result["elbow", "armature"] == 0.01
    assert ("elbow", "damping") not in result


def test_an_identified_mjcf_is_read(tmp_path, robot):
    (tmp_path / "identified.xml").write_text(robot.xml.replace('armature="0.02"', 'armature="0.07"'))
    assert numbers(read_fit(tmp_path / "identified.xml", robot))["elbow", "armature"] == pytest.approx(0.07)


def test_a_file_that_holds_nothing_of_the_robot_is_refused_with_what_is_read(tmp_path, robot):
    (tmp_path / "fit.json").write_text(json.dumps({"knee": {"armature": 0.1}}))
    with pytest.raises(RequestError, match="holds no number of a joint") as refused:
        read_fit(tmp_path / "fit.json", robot)
    assert "a plain table is" in str(refused.value.hint)
