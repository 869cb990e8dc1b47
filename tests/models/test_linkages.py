"""Linkages in MuJoCo begin with closed loops, at rest where they should, and swing as closed forms say."""

import pickle
from pathlib import Path

import mujoco
import numpy as np
import pytest
from four_bar import INERTIA, MJCF, PULL_N_M, TABLE, begins, four_bar
from mjcf_files import load
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from labrun.errors import ModelError
from labrun.fit.dataset import Dataset, FitTrial
from labrun.fit.output_error import fit_model
from labrun.models import load_model, simulate
from labrun.store import SignalInfo

TIME_S = np.linspace(0.0, 1.5, 301)
NOTHING = np.empty((len(TIME_S), 0))
PENDULUM = """
<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="arm">
  <joint name="hinge" axis="0 1 0" stiffness="0.5" springref="60"/>
  <inertial pos="0 0 -0.1" mass="1" diaginertia="1e-3 1e-3 1e-3"/>
</body></worldbody><keyframe><key qpos="KEY"/></keyframe></mujoco>
"""
PENDULUM_TABLE = """
name = "pendulum"
mujoco = "arm.xml"
[states]
angle = "joint.hinge.position"
rate = "joint.hinge.velocity"
[outputs]
angle = { mjcf = "joint.hinge.position", unit = "rad" }
[initial]
angle = "rest"
"""


def test_a_parallelogram_swings_as_one_pendulum_and_its_loop_stays_closed(tmp_path):
    model = four_bar(tmp_path)
    result = simulate(model, TIME_S, NOTHING, substeps=4)
    period = 4 * ellipk(np.sin(0.3) ** 2) / np.sqrt(PULL_N_M / INERTIA)
    left = result.outputs[:, 0]
    falls = np.flatnonzero((left[:-1] > 0) & (left[1:] <= 0))
    crossings = TIME_S[falls] - left[falls] * np.diff(TIME_S)[falls] / np.diff(left)[falls]
    assert np.diff(crossings).mean() == pytest.approx(period, rel=1e-4)
    angles = dict(zip(model.states, result.states.T, strict=True))
    np.testing.assert_allclose(angles["right"], angles["left"], atol=1e-6)
    np.testing.assert_allclose(angles["pin"], -angles["left"], atol=1e-6)


def test_a_trial_begins_where_it_is_told_and_the_other_joints_close_the_loop(tmp_path):
    start = begins(four_bar(tmp_path))
    assert start["left"] == 0.6
    assert start["right"] == pytest.approx(0.6, abs=1e-9)
    assert start["pin"] == pytest.approx(-0.6, abs=1e-9)


def test_measured_angles_that_leave_the_loop_open_all_move_a_little(tmp_path):
    start = begins(four_bar(tmp_path, TABLE.replace("left = 0.6", 'left = "first"')), first={"left": 0.3})
    assert start["right"] == pytest.approx(start["left"], abs=1e-9)
    assert 0.05 < start["left"] < 0.25


@pytest.mark.parametrize(("version", "notes"), [("3.6.0", 1), ("3.7.0", 0), ("4.0.0", 0), ("3.10.1", 0)])
def test_a_mujoco_that_lets_moving_loops_open_is_told(version, notes, tmp_path, monkeypatch):
    monkeypatch.setattr(mujoco, "mj_versionString", lambda: version)
    assert sum("update it to 3.7" in note for note in four_bar(tmp_path).notes) == notes


def test_rates_that_would_tear_the_loop_are_made_to_fit(tmp_path):
    start = begins(four_bar(tmp_path, TABLE + "left_rate = 1.0\n"))
    assert start["right_rate"] == pytest.approx(start["left_rate"], abs=1e-9)
    assert start["left_rate"] > 0.05


def test_a_loop_that_cannot_close_says_how_far_it_stays_open_and_what_was_held(tmp_path):
    model = four_bar(tmp_path, TABLE + "right = -0.6\n")
    with pytest.raises(
        ModelError, match=r"loops of model four-bar do not close: they stay 0\.\d+ m"
    ) as problem:
        model.initial_state({})
    assert "left, right are held by [initial]" in problem.value.hint


def test_a_linkage_at_rest_hangs_straight_down(tmp_path):
    rest = begins(four_bar(tmp_path, TABLE.replace("left = 0.6", 'left = "rest"\nright = "rest"')))
    assert rest == pytest.approx(dict.fromkeys(rest, 0.0), abs=1e-9)


@pytest.mark.parametrize("guess", ["0.1", "3.0"])
def test_rest_is_where_the_spring_carries_the_weight_and_the_balance_is_stable(guess, tmp_path):
    angle = begins(load(tmp_path, PENDULUM_TABLE, PENDULUM.replace("KEY", guess)))["angle"]
    assert 0.5 * (np.radians(60) - angle) == pytest.approx(9.81 * 0.1 * np.sin(angle), abs=1e-9)
    assert 0.5 + 9.81 * 0.1 * np.cos(angle) > 0


def test_rates_do_not_begin_at_rest(tmp_path):
    with pytest.raises(ModelError, match=r'initial\.left_rate = "rest": "rest" is for positions'):
        four_bar(tmp_path, TABLE + 'left_rate = "rest"\n')


def test_a_file_on_top_begins_elsewhere(tmp_path):
    four_bar(tmp_path)
    (tmp_path / "other.toml").write_text('base = "arm.toml"\n[initial]\nleft = -0.2\n')
    assert begins(load_model(tmp_path / "other.toml"))["right"] == pytest.approx(-0.2, abs=1e-9)
    (tmp_path / "still.toml").write_text('base = "arm.toml"\n[initial]\nleft = "rest"\nright = "rest"\n')
    assert begins(load_model(tmp_path / "still.toml"))["right"] == pytest.approx(0.0, abs=1e-9)


def test_a_state_to_begin_in_belongs_to_the_caller_and_survives_pickling(tmp_path):
    model = four_bar(tmp_path)
    first = model.initial_state({})
    kept = first.copy()
    first[:] = 0.0
    np.testing.assert_array_equal(model.initial_state({}), kept)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(model)).initial_state({}), kept)


def test_a_site_may_have_a_spring_that_is_an_expression_of_parameters(tmp_path):
    stiff = MJCF.replace('name="left" axis="0 1 0"', 'name="left" axis="0 1 0" stiffness="1"')
    table = TABLE.replace(
        "[outputs]", 'k = { value = 2.0, lower = 0.0 }\n[mjcf]\n"joint.left.stiffness" = "3*k"\n[outputs]'
    )
    model = four_bar(tmp_path, table.replace("left = {}", 'left = { stiffness = "3*k" }'), stiff)
    course = np.zeros(8)
    model.site_values.python(
        0.0, model.initial_state({}), np.zeros(1), model.vector(None, {}), np.zeros(2), course
    )
    assert course[3] == 6.0
    with pytest.raises(ModelError, match="unknown parameter 'kk'"):
        four_bar(tmp_path, table.replace("left = {}", 'left = { stiffness = "3*kk" }'), stiff)


def test_a_fit_finds_the_damping_of_a_linkage(tmp_path):
    rng, time_s, damping, noise_rad = np.random.default_rng(1), np.arange(0.0, 4.0, 0.02), 0.012, 0.002

    def slope(_, x):
        return [x[1], (-PULL_N_M * np.sin(x[0]) - damping * x[1]) / INERTIA]

    trials = []
    for start in (0.3, 0.7):
        clean = solve_ivp(slope, (0.0, 4.0), [start, 0.0], t_eval=time_s, rtol=1e-8, atol=1e-10).y[0]
        seen = clean[:, None] + noise_rad * rng.normal(size=(len(time_s), 1))
        trials.append(
            FitTrial(f"from {start}", {"start": start}, 1, time_s, np.empty((len(time_s), 0)), seen)
        )
    data = Dataset("four-bar", Path("four-bar"), "recording", (), (SignalInfo("left", "rad"),), tuple(trials))
    table = TABLE.replace('name = "four-bar"', 'name = "four-bar"\nconditions = ["start"]')
    table = table.replace('{ mjcf = "joint.left.damping",', '{ value = 0.004, mjcf = "joint.left.damping",')
    model = four_bar(tmp_path, table.replace("left = 0.6", 'left = "start"'))
    result = fit_model(model, data, rng=np.random.default_rng(0), starts=1)
    assert result.parameters["friction"].value == pytest.approx(damping, rel=0.03)
    assert result.rmse["left"] == pytest.approx(noise_rad, rel=0.1)
