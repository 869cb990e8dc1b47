"""The camera stabiliser as shipped: checked, tracked in a dry run, level with its loop and not without."""

import json
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from forked_labrun import run_labrun

from labrun.app.open import OpenRun
from labrun.app.open import open as open_run
from labrun.devices import Limits
from labrun.experiment import load_experiment, shipped_experiments

STEP_S = 0.02
FEW = (
    "--dry-run", "--seed", "3", "--set", "trial.duration_s=15", "--set", "trial.repeats=2",
    "--set", 'track.conditions=[{controller="off", gain=0}, {controller="P", gain=0.2}]',
)  # fmt: skip


@dataclass(frozen=True)
class Run:
    trials: pd.DataFrame
    opened: OpenRun

    def of(self, controller: str) -> pd.DataFrame:
        return self.trials[self.trials.controller == controller]


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    """Two trials with the loop, two without."""
    folder = tmp_path_factory.mktemp("stabilise")
    done = run_labrun("track", "stabilise", *FEW, "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    opened = open_run(folder / json.loads(done.stdout)["run"])
    return Run(opened.trials.query("status == 'done'"), opened)


def test_the_plan_is_within_the_servos_limits(labrun):
    done = labrun("check", "stabilise", "--json")
    assert done.code == 0, done.err
    assert done.json["trials"] == 20


def test_the_loop_keeps_the_camera_level_while_the_base_moves_as_much_as_without(run):
    off, level = run.of("off"), run.of("P")
    assert (len(off), len(level)) == (2, 2)
    assert level.tip_tilt.max() < 0.35 * off.tip_tilt.min()
    assert level.base_tilt.min() > 0.6 * off.base_tilt.max()
    np.testing.assert_allclose(off.tip_tilt, off.base_tilt, rtol=0.15)  # sag only: nothing moves the servos


def test_each_servo_works_against_the_tilt_of_its_own_axis(run):
    (index, *_) = run.of("P").index
    loop = run.opened.signals("loop", trial=index)
    base = run.opened.signals("base_imu", trial=index)
    for drive, lean in (("x_drive", base["roll"]), ("y_drive", -base["pitch"])):
        seen = np.interp(loop.time_s, base.time_s, lean)
        # The drive follows the base, some 0.1 s behind it.
        lagged = [np.corrcoef(loop[drive][lag:], seen[: len(seen) - lag])[0, 1] for lag in range(15)]
        assert max(lagged) > 0.97


def test_the_loop_is_recorded_at_its_rate_with_errors_that_are_reference_less_feedback(run):
    (index, *_) = run.of("P").index
    loop = run.opened.signals("loop", trial=index)
    np.testing.assert_allclose(np.diff(loop.time_s), STEP_S, atol=1e-3)
    for axis in "xy":
        np.testing.assert_allclose(
            loop[f"{axis}_error"], loop[f"{axis}_reference"] - loop[f"{axis}_feedback"]
        )
        assert np.abs(loop[f"{axis}_reference"]).max() == 0
    assert float(loop.latency_s.median()) < 0.05


def test_the_same_seed_gives_the_same_tilt_and_a_resumed_run_goes_on_to_it(run, labrun, tmp_path):
    part = labrun("track", "stabilise", *FEW, "--limit", "2", "--results", tmp_path / "part", "--json")
    assert part.code == 0, part.err
    resumed = labrun("resume", part.json["run"], "--json")
    assert resumed.code == 0, resumed.err
    again = open_run(tmp_path / resumed.json["run"]).trials
    pd.testing.assert_frame_equal(
        again[["controller", "tip_tilt"]], run.opened.trials[["controller", "tip_tilt"]]
    )


def test_a_delay_that_nobody_knew_of_sets_a_higher_gain_swinging_and_not_the_one_advised(labrun, tmp_path):
    done = labrun(
        "track", "stabilise", "--dry-run", "--seed", "1", "--json", "--set", "trial.duration_s=10",
        "--set", "trial.repeats=1",
        "--set", 'track.conditions=[{controller="P", gain=0.2}, {controller="P", gain=0.3}]',
        "--set", 'rig.scene.hide=[{effect="delay", site="servo_1", values={delay=0.05}}]',
    )  # fmt: skip
    assert done.code == 0, done.err
    tilt_deg = np.degrees(open_run(tmp_path / done.json["run"]).trials.set_index("gain").tip_tilt)
    assert tilt_deg[0.2] < 3.0
    assert tilt_deg[0.3] > 6.0


def _plant(omega, weight=1.0):
    """Frequency response from a step's correction to what the IMU sees of it, but for the sum of the steps."""
    import control

    s = control.tf("s")
    natural, (k, b, inertia, gravity) = 2 * np.pi * 15, (0.114, 6e-4, weight * 2e-5, weight * 6e-3)
    servo = natural**2 / (s**2 + 1.6 * natural * s + natural**2)
    laminate = k / (inertia * s**2 + b * s + k - gravity)
    jw = 1j * omega
    # IMU, mean age of its newest sample, mean wait for the servo's next command.
    late = np.exp(-jw * (0.0138 + 0.005 + 0.0025))
    ramps = ((1 - np.exp(-jw * STEP_S)) / (jw * STEP_S)) ** 2  # held, and gone to in a straight line
    return (servo * laminate)(jw) * late * ramps


@pytest.mark.parametrize(
    ("gain", "gain_margin", "phase_margin_deg", "peak"),
    [(0.1, 4.9, 74, 1.3), (0.2, 2.4, 57, 1.8), (0.3, 1.6, 39, 2.8)],
)
def test_the_margins_that_the_file_gives_as_its_reason_for_the_gain_hold(
    gain, gain_margin, phase_margin_deg, peak
):
    import control

    omega = np.linspace(0.3, 0.999 * np.pi / STEP_S, 20_000)
    loop = control.frd(gain * _plant(omega) / (1 - np.exp(-1j * omega * STEP_S)), omega)
    margin, phase, distance, *_ = control.stability_margins(loop)
    assert margin == pytest.approx(gain_margin, abs=0.06)
    assert phase == pytest.approx(phase_margin_deg, abs=0.6)
    assert 1 / distance == pytest.approx(peak, abs=0.06)


@pytest.mark.parametrize(("gain", "gain_margin"), [(0.2, 1.9), (0.3, 1.2)])
def test_with_a_camera_of_twice_the_weight_the_smaller_gain_keeps_a_margin(gain, gain_margin):
    import control

    omega = np.linspace(0.3, 0.999 * np.pi / STEP_S, 20_000)
    loop = control.frd(gain * _plant(omega, weight=2.0) / (1 - np.exp(-1j * omega * STEP_S)), omega)
    assert control.stability_margins(loop)[0] == pytest.approx(gain_margin, abs=0.06)


def test_the_loops_stay_within_the_servos_range_and_speed_and_never_see_the_base_imu():
    experiment = load_experiment(shipped_experiments() / "stabilise.toml").experiment
    bounds = Limits.model_validate(experiment.rig.devices["servos"].settings["limits"])
    for loop in experiment.track.loops.values():
        assert bounds.angle_deg[0] <= loop.range[0] < loop.range[1] <= bounds.angle_deg[1]
        assert loop.slew_per_s <= bounds.speed_deg_s <= 330 * 0.229 * 6
    places = {name: table.settings.get("mounted_on") for name, table in experiment.rig.devices.items()}
    assert (places["tip_imu"], places["base_imu"]) == ("end_effector", "base")
    assert all(
        loop.feedback.settings["channel"].startswith("tip_imu.") for loop in experiment.track.loops.values()
    )
