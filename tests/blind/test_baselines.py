"""The two baselines as `labrun gap check --tool` runs them: a folder in, an answer out."""

import sys
from pathlib import Path

import numpy as np
import pytest

from labrun.blind.judging import Reply
from labrun.blind.tool import Tool, ask_tool

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
MODEL = """
name = "hinge"
states = ["angle", "rate"]
inputs = ["torque"]
[parameters]
inertia = { value = 1.0, tolerance = 0.0, unit = "kg m^2" }
stiffness = { value = 4.0, tolerance = "free", unit = "N m/rad" }
damping = { value = 0.2, tolerance = "free", unit = "N m s/rad" }
[equations]
angle = "rate"
rate = "(torque + force.hinge - stiffness*angle - damping*rate) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.hinge]
kind = "joint"
coordinate = "angle"
rate = "rate"
[initial]
angle = 0.0
rate = 0.0
"""


def recording(friction_n_m: float) -> dict[str, bytes]:
    """Return the files of a driven hinge, integrated at a fifth of a millisecond, three conditions, twice each."""
    rng, step_s, every = np.random.default_rng(3), 2e-4, 50
    files = {"model.toml": MODEL.encode()}
    index = [
        'experiment = "hinge"',
        '[channels.torque]\nkind = "input"\nunit = "N m"\nbetween = "linear"',
        '[channels.angle]\nkind = "output"\nunit = "rad"',
    ]
    for frequency_hz in (0.2, 0.31, 0.5):
        angle = rate = 0.0
        rows = []
        for number in range(30_000):
            torque = 3.0 * np.sin(2 * np.pi * frequency_hz * number * step_s)
            if number % every == 0:
                rows.append((number * step_s, torque, angle))
            friction = friction_n_m * np.tanh(rate / 0.005)
            rate += step_s * (torque - 4.3 * angle - 0.25 * rate - friction)
            angle += step_s * rate
        for repeat in (1, 2):
            name = f"trial{len(files):03d}.csv"
            lines = [
                f"{time:.6f},{torque:.8g},{angle + 1e-3 * rng.standard_normal():.8g}"
                for time, torque, angle in rows
            ]
            files[name] = "\n".join(["time_s,torque,angle", *lines, ""]).encode()
            index.append(
                f'[[trials]]\nfile = "{name}"\nrepeat = {repeat}\ncondition = {{ frequency_hz = {frequency_hz} }}'
            )
    files["recording.toml"] = "\n".join([*index, ""]).encode()
    return files


def answered(script: str, files: dict[str, bytes]) -> Reply:
    return Reply.of_tool(
        ask_tool(Tool(script, (sys.executable, str(BENCHMARKS / f"{script}.py")), 300.0), "case", files)
    )


@pytest.mark.slow
@pytest.mark.parametrize("script", ["least_squares_bic", "sparse_regression"])
def test_plain_dry_friction_is_the_leading_cause_of_a_baseline(script: str) -> None:
    if script == "sparse_regression":
        pytest.importorskip("pysindy")
    reply = answered(script, recording(friction_n_m=0.3))
    assert reply.answer is not None, reply.reason
    assert str(reply.answer.causes[0].name) == "coulomb-friction at hinge"
    assert reply.answer.gap
