"""The bench of flapping wings: what is mounted, what it feels, and that it goes on exactly after a restart."""

import json
import math

import numpy as np
import pytest
from labrun_plugins.rigs.buckling_fin.wing_scene import FlappingWing
from labrun_plugins.rigs.buckling_fin.wings import wing

from labrun.app.question import ask
from labrun.app.run import run
from labrun.devices import Trajectory
from labrun.errors import SpecError
from labrun.experiment import shipped_experiments
from labrun.models import load_model, simulate

TIME_S = np.arange(0.0, 10.0, 0.01)


def bench(seed=0, **keys):
    return FlappingWing({"noise": 0, **keys}, np.random.default_rng(seed))


def stroke(frequency_hz=0.4, amplitude_deg=66.0, cycles=4):
    time_s = np.arange(0.0, cycles / frequency_hz, 0.01)
    angle = math.radians(amplitude_deg) * np.sin(2 * math.pi * frequency_hz * time_s)
    return Trajectory(("wing",), time_s, angle[:, None], 1 / frequency_hz)


def flapped(made, motion, signals=("force_x", "force_y", "torque_z"), time_s=TIME_S):
    made.observe(("torque_z",), np.zeros(1))
    made.drive("wing", motion, 1.0)
    return made.observe(signals, 1.0 + time_s)


def test_the_bench_feels_what_its_model_says():
    felt = flapped(bench(as_modelled=True), stroke())[:, 2]
    message = np.interp(np.arange(0, 10, 0.001), stroke().time_s, stroke().angle_rad[:, 0])
    keys = {"servo_frequency": 60.0, "servo_damping": 1.0}
    text = simulate(
        wing("water"), np.arange(0, 10, 0.001), message[:, None], parameters=keys, condition={"beams": 1, "wings": 1},
        substeps=1,
    ).outputs[::10, 2]  # fmt: skip
    assert felt == pytest.approx(text, abs=2e-4)
    assert felt.min() < -0.4


def test_the_model_of_the_gap_is_the_bench_with_nothing_hidden_but_for_noise(tmp_path):
    keys = ["sweep.where=['frequency_hz > 0.3', 'beams + wings <= 2']", "by_hand.mountings=1"]
    made = run("wing-water", dry_run=True, overrides=keys, seed=3, hide=["none"], results=tmp_path)
    asked = ask(made.run, None, workspace=shipped_experiments().parent)
    (trial,) = asked.dataset.trials
    result = simulate(asked.model, trial.time_s, trial.inputs, condition=trial.condition, substeps=8)
    _, _, torque_n_m, link_rad, plate_rad = np.std(trial.outputs - result.outputs, axis=0)
    assert torque_n_m < 0.3e-3  # noise of the sensor: 0.2e-3; with steps and frames of the servo it is 1e-3
    assert max(link_rad, plate_rad) < 1.6e-3  # noise of the cameras: 1.5e-3 in orientation


def test_two_mirrored_wings_push_ahead_and_nothing_else_is_left():
    first, two = (flapped(bench(wings=wings), stroke())[500:] for wings in (1, 2))
    assert two[:, 0] == pytest.approx(2 * first[:, 0])
    assert np.abs(two[:, 1:]).max() == 0.0
    assert two[:500, 0].mean() > 0.1
    assert first[:500, 0].mean() > 0.05


def test_two_beams_recover_with_more_torque_than_one():
    first, two = (flapped(bench(beams=beams), stroke())[500:, 2] for beams in (1, 2))
    assert two.max() > 1.5 * first.max()


def test_the_short_beam_does_not_buckle_in_air_where_the_long_one_does():
    def bends(short):
        made = bench(medium="air", short=short, coupling_hz=12)
        time_s = np.arange(1.0, 3.0, 0.002)
        half_turns = flapped(made, stroke(2.28, 66.0, 8), ("link_qz", "plate_qz"), time_s)
        link, plate = -2 * np.arcsin(half_turns).T
        return plate - link

    assert bends(0).min() < -0.06 / 0.8
    assert bends(1).min() > -0.65 / 3.0


def test_poses_are_those_of_the_angles_that_turn_about_minus_z():
    made = bench()
    seen = flapped(
        made, stroke(0.1, 30.0), ("link_x", "link_y", "link_qz", "plate_x", "plate_y"), np.array([2.5])
    )[0]
    angle = -2 * math.asin(seen[2])
    assert angle == pytest.approx(math.radians(30), abs=0.01)
    assert seen[:2] == pytest.approx([0.0616 * math.sin(angle), 0.0616 * math.cos(angle)], abs=1e-9)
    assert math.hypot(seen[3], seen[4]) < 0.1232 + 0.11245


def test_a_person_mounts_other_beams_and_what_is_not_to_be_had_is_refused():
    made = bench(noise=1)
    before = made.truth()["parameters"]["stiffness"]
    made.arrange({"beams": 1, "frequency_hz": 0.3})
    assert made.truth()["parameters"]["stiffness"] == before
    made.arrange({"beams": 2})
    assert made.truth()["mounted"] == {"beams": 2.0, "wings": 1.0}
    assert made.truth()["parameters"]["stiffness"] != before
    with pytest.raises(SpecError, match="beams"):
        made.arrange({"beams": 3})


@pytest.mark.parametrize(
    ("effect", "site"),
    [("coulomb-friction", "hinge"), ("drag-error", "plate"), ("delay", "wing"), ("bias", "torque_z")],
)
def test_effects_hide_in_hinge_plate_servo_and_sensor(effect, site):
    plain, hiding = bench(), bench(hide=[{"effect": effect, "site": site}])
    assert [hidden["effect"] for hidden in hiding.truth()["hidden"]] == [effect]
    assert np.abs(flapped(plain, stroke()) - flapped(hiding, stroke()))[:, 2].max() > 1e-3


def test_a_stored_bench_goes_on_to_the_last_bit():
    made = bench(seed=3, noise=1, hide=[{"effect": "delay", "site": "wing"}])
    flapped(made, stroke(), time_s=TIME_S[:300])
    again = bench(seed=9, noise=1, hide=[{"effect": "delay", "site": "wing"}])
    again.restore(json.loads(json.dumps(made.snapshot())))
    later = 1.0 + TIME_S[300:]
    assert np.array_equal(made.observe(("torque_z",), later), again.observe(("torque_z",), later))
    assert made.truth() == again.truth()


IN_AIR = [  # Table 7.1: beams, whether the short one, Hz, net work of a cycle (J), whether the beam was seen to buckle
    (1, 0, 1.38, -0.005, False),
    (1, 0, 2.06, 0.154, True),
    (1, 0, 2.28, 0.165, True),
    (2, 0, 2.06, 0.013, False),
    (2, 0, 2.28, 0.019, False),
    (2, 0, 2.48, 0.095, True),
    (1, 1, 2.28, -0.009, False),
]


@pytest.mark.parametrize(("beams", "short", "frequency_hz", "net_j", "buckles"), IN_AIR)
def test_work_in_air_is_that_of_the_table_and_worth_its_effort_where_the_beam_buckles(
    beams, short, frequency_hz, net_j, buckles
):
    time_s = np.arange(0.0, 8 / frequency_hz, 0.001)
    message = math.radians(66) * 2 / math.pi * np.arcsin(np.sin(2 * math.pi * frequency_hz * time_s))
    model = load_model(
        shipped_experiments() / "models" / "wing-air.toml"
    )  # its angle is late, as the cameras'
    outputs = simulate(
        model, time_s, message[:, None], condition={"beams": beams, "short": short}, substeps=1
    ).outputs
    torque, angle = -outputs[:, 2], outputs[:, 3]
    last = time_s >= 4 / frequency_hz
    way, torque = np.abs(np.gradient(angle[last])), torque[last]
    net, total = np.sum(torque * way) / 4, np.sum(np.abs(torque) * way) / 4
    assert net == pytest.approx(net_j, abs=0.04)
    assert (abs(net) / total > 0.09) if buckles else (abs(net) / total < 0.05)
