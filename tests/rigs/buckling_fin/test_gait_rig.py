"""The gait rig: what its sensor feels of one fin and of two, its beams, and that it goes on exactly after a restart."""

import json
import math

import numpy as np
import pytest
from labrun_plugins.rigs.buckling_fin.gait_rig import GaitRig, GaitRigSettings, swimmer
from labrun_plugins.rigs.buckling_fin.model import fin_model

from labrun.devices import Trajectory
from labrun.models import Stepper

FELT = ("force_x", "force_y", "torque_z")


def rig(seed=0, **keys):
    return GaitRig({"noise": 0, **keys}, np.random.default_rng(seed))


def held(joint, value):
    return Trajectory((joint,), np.zeros(1), np.array([[value]]))


def stroke(joint, amplitude_deg, frequency_hz, cycles=8, phase_deg=0.0):
    time_s = np.arange(0.0, cycles / frequency_hz, 0.005)
    angle = math.radians(amplitude_deg) * np.sin(
        2 * math.pi * frequency_hz * time_s + math.radians(phase_deg)
    )
    return Trajectory((joint,), time_s, angle[:, None], 1 / frequency_hz)


def mean_load(made, *, alpha=45.0, f=0.6, phase_deg=None, slider=1.0, cycles=8):
    """Return the mean load of the last cycles, (force x, force y, torque z)."""
    made.observe(FELT, np.zeros(1))
    made.drive("slider", held("slider", slider), 0.5)
    made.drive("fin_1", stroke("fin_1", alpha, f, cycles), 1.0)
    if phase_deg is not None:
        made.drive("fin_2", stroke("fin_2", alpha, f, cycles, phase_deg), 1.0)
    time_s = 1.0 + np.arange(cycles / 2 / f, cycles / f - 1e-9, 0.005)
    return made.observe(FELT, time_s).mean(axis=0)


def test_one_fin_on_the_short_beam_leaves_a_push_to_the_side_and_none_ahead():
    ahead, aside, _ = mean_load(rig(), alpha=87, f=0.5)
    assert abs(ahead) < 0.002
    assert aside < -0.01


def test_on_the_long_beam_the_same_stroke_pushes_ahead_and_turns():
    ahead, _, turning = mean_load(rig(), slider=0.0, alpha=60, f=0.8)
    assert ahead > 0.05
    assert abs(turning) > 5e-3


def test_two_mirrored_fins_in_phase_push_ahead_only():
    ahead, aside, turning = mean_load(rig(), slider=0.0, phase_deg=0.0)
    assert ahead > 0.1
    assert abs(aside) < 1e-9
    assert abs(turning) < 1e-9


def test_on_a_mount_that_does_not_yield_the_fins_cancel_whatever_their_phase():
    stiff = {"mount_n_m": 1e5, "yaw_n_m_rad": 1e3, "mount_n_s_m": 100.0, "yaw_n_m_s": 1.0}
    load = abs(mean_load(rig(**stiff))[1])
    for phase_deg in (90.0, 330.0):
        assert abs(mean_load(rig(**stiff), phase_deg=phase_deg)[1]) < 0.1 * load


def test_on_the_arm_an_undulation_pushes_more_than_one_fin_does():
    best = max(
        abs(mean_load(rig(), alpha=alpha, f=f)[1])
        for alpha, f in ((45, 0.6), (87, 0.5), (45, 1.0), (31, 1.2))
    )
    undulation = mean_load(rig(), alpha=31, f=1.0, phase_deg=300.0)
    assert abs(undulation[1]) > 1.3 * best


def let_loose(alpha_deg, second_deg, f, phase_deg, platform):
    """Return how fast the swimmer goes under a platform with these areas, m/s, once it is up to its speed."""
    held = swimmer(GaitRigSettings(), short=True)
    values = dict(zip((parameter.name for parameter in held.parameters), held.values.tolist(), strict=True))
    mount = dict.fromkeys(("mount_stiffness", "mount_damping", "yaw_stiffness", "yaw_damping"), 0.0)
    free = fin_model("free-swimmer", fins=2, free=("x", "y", "yaw")).with_values(
        {**values, **mount, **platform}
    )
    time_s = np.arange(0.0, 20.0, 2.5e-4)  # no mount holds the fins' recoil: finer than on the arm
    turn = 2 * np.pi * f * time_s
    message = np.column_stack([alpha_deg * np.sin(turn), second_deg * np.sin(turn + np.radians(phase_deg))])
    seen = Stepper(free, step_s=2.5e-4).advance(np.radians(message))
    half = len(time_s) // 2
    return np.hypot(*(seen[-1, 3:5] - seen[half, 3:5])) / (time_s[-1] - time_s[half])


@pytest.mark.parametrize(
    "platform", [{"body_side_area": 0.01, "yaw_drag": 0.01}, {"body_side_area": 0.03, "yaw_drag": 0.05}]
)
def test_let_loose_the_undulation_that_pushes_more_swims_slower(platform):
    flapping = let_loose(60, 0, 0.8, 0, platform)
    assert let_loose(31, 31, 1.0, 300, platform) < 0.8 * flapping


def test_under_a_platform_that_hardly_turns_flapping_is_as_fast_as_the_sources():
    platform = {
        "body_mass": 2.0,
        "body_inertia": 0.1,
        "body_area": 0.008,
        "body_side_area": 0.008,
        "yaw_drag": 0.01,
    }
    assert let_loose(86.8, 0, 0.55, 0, platform) == pytest.approx(0.17, abs=0.03)
    assert let_loose(88.4, 88.4, 0.539, 67.5, platform) < 0.05
    alone = {**platform, "body_mass": 1.0, "body_inertia": 0.005}
    assert let_loose(86.8, 0, 0.55, 0, alone) < 0.08


def test_what_is_stuck_stays_long():
    stuck = rig(slider_stuck_at=0.4)
    assert mean_load(stuck) == pytest.approx(mean_load(rig(), slider=0.0))
    assert stuck.truth()["beam"] == "long"


@pytest.mark.parametrize(
    ("effect", "site"),
    [("coulomb-friction", "hinge_1"), ("drag-error", "plate_2"), ("delay", "fin_1"), ("bias", "force_y")],
)
def test_effects_hide_in_hinges_plates_servos_and_sensor(effect, site):
    plain, hiding = rig(), rig(hide=[{"effect": effect, "site": site}])
    loads = [mean_load(other, phase_deg=60.0, cycles=4) for other in (plain, hiding)]
    assert hiding.truth()["hidden"][0]["site"] == site
    assert np.abs(loads[0] - loads[1]).max() > 1e-5


def test_a_stored_rig_goes_on_to_the_last_bit_also_while_its_beams_change():
    made = rig(seed=3, noise=1)
    made.observe(FELT, np.zeros(1))
    made.drive("fin_1", stroke("fin_1", 40, 0.8), 0.1)
    made.drive("slider", Trajectory(("slider",), np.array([0.0, 1.0]), np.array([[0.0], [1.0]])), 0.5)
    made.observe(FELT, np.array([0.9]))
    again = rig(seed=8, noise=1)
    again.restore(json.loads(json.dumps(made.snapshot())))
    later = np.arange(0.95, 2.5, 0.01)
    assert np.array_equal(made.observe(FELT, later), again.observe(FELT, later))
    assert made.truth() == again.truth()
