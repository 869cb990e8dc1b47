"""What was searched is told, ranges follow what the data want, and mistakes of sign and unit are named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labrun.effects import Scale, load_effect
from labrun.fit import Dataset, OutputNoise
from labrun.fit.dataset import FitTrial
from labrun.gap.averaging import averaged
from labrun.gap.candidates import candidates, site_scales, untried
from labrun.gap.diagnose import diagnose_dataset
from labrun.gap.evidence import Units
from labrun.gap.intervals import scatter
from labrun.gap.noise import of_sensor
from labrun.gap.recalibration import stated, stated_problem, unit_remarks
from labrun.gap.screening import Base
from labrun.models import parse_model
from labrun.store import SignalInfo

from .benches import PENDULUM, FloatArray, Force, among, dry_friction, logged, pendulum, recorded


def in_other_units(data: Dataset, factor: float) -> Dataset:
    trials = tuple(
        replace(trial, outputs=factor * trial.outputs, members=(factor * trial.outputs,))
        for trial in data.trials
    )
    return replace(data, trials=trials)


@pytest.mark.parametrize(
    ("factor", "words"), [(-1.0, "flipped"), (180.0 / np.pi, "degrees labelled rad"), (0.001, "labelled mm")]
)
def test_a_flipped_sign_and_a_wrong_unit_are_named(factor: float, words: str) -> None:
    data = in_other_units(recorded(repeats=1), factor)
    problem = stated_problem(pendulum(), data)
    (remark,) = unit_remarks(problem, stated(problem, problem.begin()))
    assert words in remark


def test_nothing_is_said_of_units_that_are_right() -> None:
    problem = stated_problem(pendulum(), in_other_units(recorded(dry_friction(0.006), repeats=1), 1.0))
    assert unit_remarks(problem, stated(problem, problem.begin())) == ()


def test_what_a_model_has_no_place_for_is_said_with_what_to_add() -> None:
    bare = PENDULUM.replace('stiffness = "stiffness"\n', "")
    message = " ".join(untried(parse_model(bare, "pendulum.toml")))
    assert "backlash" in message
    assert 'add stiffness = "..." to [sites.hinge]' in message
    assert not untried(pendulum())


SWING = """
name = "swing"
states = ["angle", "rate"]
[parameters]
inertia = { value = 1.0e-3, tolerance = 0.05,   unit = "kg m^2" }
gravity = { value = 0.06,   tolerance = 0.05,   unit = "N m" }
damping = { value = 1.0e-4, tolerance = "free", unit = "N m s/rad" }
[equations]
angle = "rate"
rate = "(force.hinge - damping*rate - gravity*sin(angle)) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.hinge]
kind = "joint"
coordinate = "angle"
rate = "rate"
[initial]
angle = "release"
rate = 0.0
"""


def test_intervals_carry_what_is_stated_of_a_scale_that_the_data_do_not_show() -> None:
    time_s = np.arange(0.0, 4.0, 0.02)
    nothing_yet = np.sin(7.7 * time_s)[:, None]
    trials = tuple(
        FitTrial(
            f"{release} rad",
            {"release": release},
            1,
            time_s,
            np.empty((len(time_s), 0)),
            release * nothing_yet,
        )
        for release in (0.4, 0.9)
    )
    outputs = (SignalInfo("angle", "rad", "linear"),)
    data = averaged(
        Dataset("swing", Path("swing"), "recording", (), outputs, trials), parse_model(SWING, "swing.toml")
    )
    problem = stated_problem(parse_model(SWING, "swing.toml"), data)
    friction = load_effect("coulomb-friction").attach("hinge", torque=2e-3, transition_speed=0.05)
    problem = problem.with_effects([friction], [Scale(force=1e-3)]).with_noise(OutputNoise(np.array([1e3])))
    z = problem.begin()
    base = Base.of(problem.with_measured(problem.simulated(z)), z)
    noise = of_sensor(
        data, [np.random.default_rng(1).standard_normal(trial.outputs.shape) for trial in data.trials]
    )
    units = Units.of(
        data, [np.random.default_rng(2).standard_normal(trial.outputs.shape) for trial in data.trials]
    )
    torque = scatter(base, noise, units, np.random.default_rng(0))[:, -1] / z[problem.size - 1]
    # all torques scale together with the inertia: of the scale, two statements of 5 % each tell what they can
    assert np.std(torque) == pytest.approx(0.05 / np.sqrt(2.0), rel=0.1)


def test_a_sensor_is_not_saturated_below_what_it_read() -> None:
    problem = stated_problem(pendulum(), recorded(repeats=1))
    scales = site_scales(problem, problem.begin())
    levels = {
        candidate.name.site: candidate.attached.effect.parameters[0].lower
        for candidate in candidates(problem.model, scales)
        if candidate.name.effect == "saturation" and candidate.attached is not None
    }
    assert 0.8 < levels["angle"] < 1.0
    assert levels["torque"] < 0.1  # what an amplifier gave is not known


def stop(level: float, stiffness: float) -> Force:
    return lambda t, q, v: -stiffness * (max(q - level, 0.0) + min(q + level, 0.0))


@pytest.mark.slow
def test_a_late_stop_far_stiffer_than_its_joint_is_found_with_its_stiffness_beside_another_cause() -> None:
    """It is 130 times as stiff as the joint, and reached in the last fiftieth of the largest motion only."""
    peak = max(float(np.max(np.abs(trial.outputs))) for trial in recorded().trials)
    drifting = recorded(
        stop(0.98 * peak, 10.0), seen=lambda angle: angle + 0.05 * np.arange(len(angle)) / len(angle)
    )
    few = among("end-stop", "drift", "cubic-stiffness", "saturation", "bias")
    causes = {cause.name.effect: cause.values for cause in diagnose_dataset(drifting, pendulum(), few).causes}
    assert set(causes) == {"end-stop", "drift"}
    assert causes["end-stop"]["stiffness"].value == pytest.approx(10.0, rel=0.05)
    assert causes["end-stop"]["upper"].value == pytest.approx(0.98 * peak, rel=0.005)


VESSEL = """
name = "vessel"
states = ["position", "speed"]
inputs = { thrust = { unit = "N", between = "hold" } }
[parameters]
mass = { value = 40.0, tolerance = 0.03, unit = "kg" }
drag = { value = 30.0, tolerance = 0.05, unit = "N s^2/m^2" }
[equations]
position = "speed"
speed = "(force.hull + thrust - drag*speed*abs(speed)) / mass"
[outputs]
speed = { equation = "speed", unit = "m/s" }
[sites.hull]
kind = "body"
coordinate = "position"
rate = "speed"
unit = "m"
[initial]
position = 0.0
speed = 0.0
"""


def test_a_current_is_found_with_a_drag_far_larger_than_what_moves_a_body_as_far() -> None:
    time_s = np.arange(0.0, 120.0, 0.2)
    thrust = np.where(time_s % 30.0 < 6.0, 12.0, 0.0)  # it coasts, and is easily pushed then

    def slope(t: float, x: FloatArray) -> list[float]:
        past = x[0] - 0.15
        return [(thrust[min(int(t / 0.2 + 1e-9), len(thrust) - 1)] - 30.0 * past * abs(past)) / 40.0]

    moved = solve_ivp(slope, (0.0, 120.0), [0.0], t_eval=time_s, rtol=1e-8, atol=1e-10, max_step=0.1)
    speed = moved.y[0] + 0.01 * np.random.default_rng(2).standard_normal(len(time_s))
    trial = FitTrial("log", {}, 1, time_s, thrust[:, None], speed[:, None])
    channels = SignalInfo("thrust", "N", "hold"), SignalInfo("speed", "m/s", "linear")
    data = logged("vessel", *channels, [trial])
    dataset = diagnose_dataset(
        data, parse_model(VESSEL, "vessel.toml"), among("mean-current", "drag-error", "bias", "delay")
    )
    (cause,) = dataset.causes
    assert str(cause.name) == "mean-current at hull"
    assert cause.values["coefficient"].value == pytest.approx(30.0, rel=0.05)
    assert cause.values["speed"].value == pytest.approx(0.15, rel=0.1)
