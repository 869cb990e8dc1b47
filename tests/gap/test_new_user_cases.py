"""Benches as a new user has them, each with a truth that an idealised answer gets wrong.

Every truth is integrated here, by explicit steps or by scipy: nothing of it is labrun's. The library holds the right
answer, and what stood in for it when it was tried with the whole library.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from labrun.fit.dataset import Dataset, FitTrial
from labrun.gap import Diagnosis, diagnose_dataset
from labrun.models import parse_model
from labrun.store import SignalInfo

from .benches import PENDULUM, TRUE, FloatArray, among, logged, pendulum, recorded


def effects(diagnosis: Diagnosis) -> set[str]:
    """Return the effects and parameters that are named as causes."""
    return {cause.name.effect for cause in diagnosis.causes}


def rivals(diagnosis: Diagnosis, effect: str) -> set[str]:
    """Return the rivals of a cause."""
    (cause,) = [cause for cause in diagnosis.causes if cause.name.effect == effect]
    return {rival.effect for rival in cause.rivals}


# --- Stribeck friction ---


def stribeck(t: float, q: float, v: float) -> float:
    """Return dry friction that is twice as large at rest as in motion."""
    return -0.006 * (1.0 + 1.5 * float(np.exp(-((v / 0.4) ** 2)))) * float(np.tanh(v / 0.06))


SIX = ((0.02, 0.6), (0.03, 0.9), (0.04, 1.2), (0.03, 1.7), (0.05, 0.8), (0.06, 0.5))


def test_stribeck_friction_of_six_trials_has_no_rival_coulomb_friction() -> None:
    dataset = diagnose_dataset(
        recorded(stribeck, repeats=1, noise=2e-3, conditions=SIX),
        pendulum(),
        among("coulomb-friction", "stribeck-friction"),
    )
    assert effects(dataset) == {"stribeck-friction"}
    assert "coulomb-friction" not in rivals(dataset, "stribeck-friction")
    assert dataset.causes[0].closes > 0.9


# --- play and friction ---

SERVO = """
name = "servo"
states = ["angle", "rate"]
inputs = { goal = { unit = "rad", between = "hold" } }
[parameters]
inertia = { value = 0.03, tolerance = 0.05, unit = "kg m^2" }
gain    = { value = 12.0, tolerance = 0.05, unit = "N m/rad" }
damping = { value = 0.8, tolerance = "free", unit = "N m s/rad", lower = 0.0 }
[equations]
angle = "rate"
rate  = "(force.joint - gain*(angle - goal) - damping*rate) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.joint]
kind = "joint"
coordinate = "angle - goal"
rate = "rate"
stiffness = "gain"
[initial]
angle = "first"
rate = 0.0
"""


PLAY, FRICTION = ("backlash", "play"), ("coulomb-friction", "stribeck-friction", "presliding-friction")


@cache
def loose_servo() -> Dataset:
    """Return five motions of a servo whose link hangs on a gear with play of .03 rad and rubs with .15 N m.

    The controller reads the motor; the recorded encoder sits on the link.
    """
    rng, trials, step_s = np.random.default_rng(5), [], 1e-4
    time_s = np.arange(0.0, 5.0, 0.01)
    goals = {
        "slow": 0.4 * np.sin(2 * np.pi * 0.25 * time_s),
        "middle": 0.3 * np.sin(2 * np.pi * 0.6 * time_s),
        "fast": 0.2 * np.sin(2 * np.pi * 1.3 * time_s),
        "small": 0.08 * np.sin(2 * np.pi * 0.5 * time_s),
        "stairs": 0.1 * np.round(3.0 * np.sin(2 * np.pi * 0.3 * time_s)),
    }
    for number, (name, goal) in enumerate(goals.items()):
        motor, motor_rate, link, link_rate, seen = 0.0, 0.0, 0.0, 0.0, []
        for aim in goal.tolist():
            seen.append(link)
            for _ in range(100):
                twist = motor - link
                over = twist - min(max(twist, -0.015), 0.015)
                contact = 800.0 * over + (0.4 * (motor_rate - link_rate) if over else 0.0)
                motor_rate += step_s * (11.7 * (aim - motor) - 0.85 * motor_rate - contact) / 0.0155
                link_rate += step_s * (contact - 0.15 * np.tanh(link_rate / 0.01)) / 0.0155
                motor += step_s * motor_rate
                link += step_s * link_rate
        angle = np.array(seen) + 5e-4 * rng.standard_normal(len(seen))
        trials.append(FitTrial(name, {"motion": float(number)}, 1, time_s, goal[:, None], angle[:, None]))
    return logged("servo", SignalInfo("goal", "rad", "hold"), SignalInfo("angle", "rad", "linear"), trials)


def test_play_and_friction_of_a_link_are_both_told_and_friction_alone_never_stands_for_them() -> None:
    dataset = diagnose_dataset(loose_servo(), parse_model(SERVO, "servo.toml"), among(*PLAY, *FRICTION))
    named = effects(dataset) | {rival.effect for cause in dataset.causes for rival in cause.rivals}
    assert named & set(PLAY)
    assert named & set(FRICTION)
    for row in dataset.candidates:
        if row.name.effect == "backlash" and "gap" in row.upper_bound:
            assert row.upper_bound["gap"].high > 0.03
    for cause in dataset.causes:
        if cause.name.effect == "coulomb-friction" and "backlash" in effects(dataset):
            assert cause.values["torque"].value == pytest.approx(0.15, rel=0.3)


# --- a term of the model that has the wrong law ---

HULL = """
name = "hull"
states = ["position", "speed"]
inputs = { thrust = { unit = "N", between = "hold" } }
[parameters]
mass = { value = 4.0, tolerance = 0.03, unit = "kg" }
drag = { value = 6.0, tolerance = "free", unit = "N s^2/m^2", lower = 0.0 }
[equations]
position = "speed"
speed = "(force.hull + thrust - drag*speed*abs(speed)) / mass"
[outputs]
speed = { equation = "speed", unit = "m/s" }
[sites.hull]
kind = "joint"
coordinate = "position"
rate = "speed"
[initial]
position = 0.0
speed = 0.0
"""


def sailed(
    slope: Callable[[float, float], float],
    forces: dict[float, Callable[[FloatArray], FloatArray]],
    noise: float,
) -> Dataset:
    """Return trials of a body of one coordinate; `slope` is its acceleration, of speed and input."""
    rng, trials, time_s = np.random.default_rng(2), [], np.arange(0.0, 20.0, 0.05)
    for condition, force in forces.items():
        inputs, speed, seen = force(time_s), 0.0, []
        for value in inputs.tolist():
            seen.append(speed)
            for _ in range(50):
                speed += 1e-3 * slope(speed, value)
        outputs = np.array(seen) + noise * rng.standard_normal(len(seen))
        trials.append(
            FitTrial(f"{condition:g} N", {"thrust": condition}, 1, time_s, inputs[:, None], outputs[:, None])
        )
    return logged("hull", SignalInfo("thrust", "N", "hold"), SignalInfo("speed", "m/s", "linear"), trials)


def test_linear_drag_in_place_of_the_models_quadratic_one_is_named() -> None:
    thrusts = {
        size: lambda t, size=size: size * np.sign(np.sin(2 * np.pi * t / (6.0 + size))) * (t < 16.0)
        for size in (1.0, 2.0, 3.0, 4.0, 5.0)
    }
    data = sailed(lambda speed, thrust: (thrust - 4.0 * speed) / 4.05, thrusts, noise=5e-3)
    dataset = diagnose_dataset(
        data,
        parse_model(HULL, "hull.toml"),
        among("viscous-damping", "quadratic-drag", "coulomb-friction", "added-inertia", "lag"),
    )
    assert "viscous-damping" in effects(dataset)
    assert dataset.verdict in ("explained", "mostly-explained")
    (drag,) = [cause for cause in dataset.causes if cause.name.effect == "viscous-damping"]
    assert drag.values["coefficient"].value == pytest.approx(4.0, rel=0.1)


# --- few samples a trial ---

FALL = """
name = "fall"
states = ["height", "rate"]
[parameters]
gravity = { value = 9.81, tolerance = 0.001, unit = "m/s^2" }
[equations]
height = "rate"
rate = "force.air - gravity"
[outputs]
height = { equation = "height", unit = "m" }
[sites.air]
kind = "joint"
coordinate = "height"
rate = "rate"
[initial]
height = "free"
rate = "free"
"""


@pytest.mark.parametrize("count", [12, 40])
def test_the_drag_of_falling_bodies_is_named_from_a_few_samples_a_drop(count: int) -> None:
    rng, trials = np.random.default_rng(4), []
    for number in range(5):
        time_s = np.linspace(0.0, 2.0 + 0.2 * number, count)
        height, rate, now, seen = 40.0 + number, 0.0, 0.0, []
        for instant in time_s.tolist():
            while now < instant:
                rate += 1e-3 * (-9.81 - 0.35 * rate)
                height += 1e-3 * rate
                now += 1e-3
            seen.append(height)
        outputs = np.array(seen) + 0.02 * rng.standard_normal(count)
        condition = {"drop": float(number)}
        trials.append(
            FitTrial(f"drop {number}", condition, 1, time_s, np.empty((count, 0)), outputs[:, None])
        )
    data = Dataset(
        "fall", Path("fall"), "recording", (), (SignalInfo("height", "m", "linear"),), tuple(trials)
    )
    few = among("viscous-damping", "coulomb-friction", "added-stiffness")
    dataset = diagnose_dataset(data, parse_model(FALL, "fall.toml"), few)
    assert effects(dataset) == {"viscous-damping"}
    assert dataset.causes[0].values["coefficient"].value == pytest.approx(0.35, rel=0.05)


# --- a force that differs by condition ---

DRONE = """
name = "drone"
states = ["position", "speed"]
inputs = { pitch = { unit = "rad", between = "hold" } }
[parameters]
gravity = { value = 9.81, tolerance = 0.0, unit = "m/s^2" }
drag = { value = 0.35, tolerance = 0.2, unit = "1/s", lower = 0.0 }
[equations]
position = "speed"
speed = "gravity*tan(pitch) - drag*speed + force.body"
[outputs]
speed = { equation = "speed", unit = "m/s" }
[sites.body]
kind = "body"
coordinate = "position"
rate = "speed"
unit = "m"
[initial]
position = 0.0
speed = 0.0
"""


def test_a_wind_that_differs_by_flight_is_neither_drag_of_any_size_nor_a_bias_larger_than_the_motion() -> (
    None
):
    winds = (0.4, -0.25, 0.1, -0.5, 0.3, 0.0)
    rng, trials, time_s = np.random.default_rng(8), [], np.arange(0.0, 15.0, 0.05)
    for number, wind in enumerate(winds):
        pitch = 0.05 * np.sin(2 * np.pi * (0.15 + 0.05 * number) * time_s)
        speed, seen = 0.0, []
        for angle in pitch.tolist():
            seen.append(speed)
            for _ in range(50):
                speed += 1e-3 * (9.81 * np.tan(angle) - 0.36 * speed + wind)
        outputs = np.array(seen) + 0.01 * rng.standard_normal(len(seen))
        trials.append(
            FitTrial(
                f"flight {number}", {"flight": float(number)}, 1, time_s, pitch[:, None], outputs[:, None]
            )
        )
    data = logged("drone", SignalInfo("pitch", "rad", "hold"), SignalInfo("speed", "m/s", "linear"), trials)
    dataset = diagnose_dataset(
        data,
        parse_model(DRONE, "drone.toml"),
        among("mean-current", "drag-error", "reynolds-dependent-drag", "bias", "drift"),
    )
    moves = max(float(np.ptp(trial.outputs)) for trial in data.trials)
    for cause in dataset.causes:
        for name, size in cause.values.items():
            if "drag" in cause.name.effect and name == "coefficient":
                assert not size.low <= 0.0
            if cause.name.effect == "bias":
                assert abs(size.value) < moves
    assert dataset.verdict != "no-gap"
    assert any(
        "differs by" in text for text in (*dataset.differs, dataset.sentence, *dataset.rest.depends_on)
    )


# --- a parameter that is far off ---


def test_an_inertia_far_beyond_its_tolerance_is_told_as_that() -> None:
    dataset = diagnose_dataset(
        recorded(true={**TRUE, "inertia": 1.6e-3}, repeats=1),
        pendulum(),
        among("coulomb-friction", "added-inertia", "delay", "lag", "bias"),
    )
    named = {(rival.kind, rival.effect) for cause in dataset.causes for rival in (cause.name, *cause.rivals)}
    assert ("parameter", "inertia") in named
    assert len(dataset.causes) == 1
    assert dataset.verdict in ("explained", "mostly-explained")


def test_a_parameter_of_the_wrong_sign_is_told_as_that() -> None:
    stiff = PENDULUM.replace('value = 0.068,  tolerance = "free"', "value = 0.3, tolerance = 0.05")
    truth = {"inertia": 1.22e-3, "gravity": -0.083, "stiffness": 0.305, "damping": 1.3e-3}
    data = recorded(
        true=truth, repeats=1, conditions=((0.06, 0.9), (0.09, 1.2), (0.12, 1.6), (0.09, 2.4), (0.15, 2.0))
    )
    dataset = diagnose_dataset(
        data,
        parse_model(stiff, "pendulum.toml"),
        among("imbalance", "coulomb-friction", "backlash", "gain-error"),
    )
    (cause,) = dataset.causes
    assert ("parameter", "gravity") in {(name.kind, name.effect) for name in (cause.name, *cause.rivals)}
    assert dataset.corrected["gravity"] == pytest.approx(-0.083, rel=0.1)
    assert "sign is reversed" in cause.remark
