"""What a drive or a joint hides from a log of goals is recovered by a fit from the starts that a diagnosis begins with.

The logs come from equations of their own, stepped at a millisecond, with gains, inertia and weight that differ from the
model's within their tolerances, and with noise.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from labrun.fit import Dataset, Problem, minimise
from labrun.fit.dataset import FitTrial
from labrun.gap.candidates import candidates, site_scales
from labrun.models import parse_model
from labrun.store import SignalInfo

INERTIA, KP, KV, DAMPING, WEIGHT = 0.41, 62.0, 4.1, 0.6, 5.9
MODEL = parse_model(
    """
name = "servo"
states = ["angle", "rate"]
[inputs]
goal = { unit = "rad", between = "hold" }
[parameters]
inertia = { value = 0.4, tolerance = 0.03, lower = 0.0 }
kp = { value = 60.0, tolerance = 0.05, lower = 0.0 }
kv = { value = 4.0, tolerance = 0.05, lower = 0.0 }
damping = { value = 0.5, tolerance = "free", lower = 0.0 }
weight = { value = 6.0, tolerance = 0.03 }
[equations]
angle = "rate"
rate = '''(force.joint + force.controller + kp*(goal - angle) - (kv + damping)*rate - weight*cos(angle))
  / inertia'''
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.joint]
kind = "joint"
coordinate = "angle"
rate = "rate"
load = "kp*(goal - angle) - kv*rate"
drive = true
[sites.controller]
kind = "controller"
coordinate = "weight*cos(angle)"
rate = "weight*cos(angle)"
[initial]
angle = "first"
rate = "free"
""",
    "servo.toml",
)
SAMPLE_S, STEPS, SAMPLES, NOISE_RAD = 0.01, 10, 400, 5e-4
Drive = Callable[[float, float, float, dict[str, float]], float]


def _weight(drive, _q, _v, _own):
    return drive


def _compensated(drive, q, _v, _own):
    return drive + 0.8 * WEIGHT * np.cos(q)


def _limited(drive, _q, _v, _own):
    return float(np.clip(drive, -9.0, 9.0))


def _loose(drive, _q, _v, _own):
    return float(drive - np.clip(drive, -KP * 0.015, KP * 0.015))


def _one_way(drive, _q, v, _own):
    return drive - 0.8 * abs(v)


def _integrated(drive, _q, v, own):
    own["z"] = own.get("z", WEIGHT) + SAMPLE_S / STEPS * (drive + KV * v) / 0.5
    return drive + own["z"]


def _profiled(goal, own):
    """Return the set-point: towards the goal, braking in time, at up to 1.2 rad/s and 6 rad/s^2."""
    h, (index, speed) = SAMPLE_S / STEPS, own.get("profile", (goal, 0.0))
    error = goal - index
    wanted = float(np.clip(np.sign(error) * np.sqrt(12.0 * abs(error)), -1.2, 1.2))
    speed += float(np.clip(wanted - speed, -6.0 * h, 6.0 * h))
    own["profile"] = (index + h * speed, speed)
    return own["profile"][0]


def _logged(law: Drive, goal_law=None, held=False) -> Dataset:
    rng, trials, h = np.random.default_rng(3), [], SAMPLE_S / STEPS
    for number in range(3):
        time_s = np.arange(SAMPLES) * SAMPLE_S
        fade = np.clip(np.minimum(time_s, time_s[-1] - time_s) / 0.5, 0.0, 1.0)
        waves = zip(rng.uniform(0.1, 0.3, 3), rng.uniform(0.2, 1.5, 3), rng.uniform(0, 6, 3), strict=True)
        goal = fade * sum(size * np.sin(2 * np.pi * f * time_s + phase) for size, f, phase in waves)
        goal += (time_s > 0.5) * (number > 0) * np.repeat(rng.uniform(-0.5, 0.5, 4), SAMPLES // 4)
        q, v, own, angle = (0.0 if held else -WEIGHT / KP), 0.0, {}, np.zeros(SAMPLES)
        for k in range(SAMPLES):
            angle[k] = q
            for _ in range(STEPS):
                wanted = goal_law(goal[k], own) if goal_law else goal[k]
                push = law(KP * (wanted - q) - KV * v, q, v, own)
                v += h * (push - DAMPING * v - WEIGHT * np.cos(q)) / INERTIA
                q += h * v
        seen = angle + NOISE_RAD * rng.standard_normal(SAMPLES)
        trials.append(FitTrial(str(number), {"motion": number}, 1, time_s, goal[:, None], seen[:, None]))
    given, shown = SignalInfo("goal", "rad", "hold"), SignalInfo("angle", "rad", "linear")
    return Dataset("servo", Path("servo"), "recording", (given,), (shown,), tuple(trials))


LOGS = {
    "gravity-compensation": (_compensated, None, False, {"share": 0.8}),
    "torque-limit": (_limited, None, False, {"level": 9.0}),
    "drive-play": (_loose, None, False, {"torque": KP * 0.015}),
    "asymmetric-damping": (_one_way, None, False, {"difference": 0.8}),
    "integral-term": (_integrated, None, True, {"integral_time": 0.5}),
    "motion-profile": (_weight, _profiled, False, {"rate": 1.2, "ramp_time": 0.2}),
}


@cache
def _recalibrated(hidden: str):
    law, goal_law, held, _ = LOGS[hidden]
    problem = Problem.of(MODEL, _logged(law, goal_law, held))
    return problem, minimise(problem, problem.begin())


def _fitted(problem, z, candidate):
    """Return the least sum of squares from the two best starts of a candidate, and its values there."""
    with_it = candidate.added_to(problem)
    starts = [np.concatenate([z[: problem.size], start, z[problem.size :]]) for start in candidate.starts]
    best = sorted(starts, key=with_it.squares)[:2]
    ends = [minimise(with_it, start, central=False, evaluations=25) for start in best]
    end = min(ends, key=with_it.squares)
    return with_it.squares(end), with_it.attached(with_it.parameters(end))[-1].named_values


@pytest.mark.parametrize("hidden", LOGS)
def test_the_size_of_what_is_hidden_is_recovered(hidden):
    problem, z = _recalibrated(hidden)
    (candidate,) = [
        other for other in candidates(MODEL, site_scales(problem, z)) if other.name.effect == hidden
    ]
    squares, values = _fitted(problem, z, candidate)
    assert squares < 0.2 * problem.squares(z)
    for name, true in LOGS[hidden][3].items():
        # a weight on one side of the play takes a part of it for its own
        assert values[name] == pytest.approx(true, rel=0.4 if hidden == "drive-play" else 0.2), name
