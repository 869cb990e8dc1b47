"""Make one sealed robot: its file as a person has it, the log of its motions, and the answer."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .body import Body, FloatArray, draw
from .hidden import EFFECTS, Joint, draw_shape, draw_size

STEP_S = 1e-3
SAMPLE_S = 1e-2
SEGMENTS, SEGMENT_S, REST_S = 10, 5.4, 0.6
"""Motions of a log, how long each is, and the rest behind it: a minute in all."""
TRAVEL_RAD = (0.25, 0.6)


def goals(rng: np.random.Generator, joints: int) -> FloatArray:
    """Return goals at the log's samples: motions of smoothly fading sines, at rest in between, all joints at once."""
    per, rest = round(SEGMENT_S / SAMPLE_S), round(REST_S / SAMPLE_S)
    course = np.zeros((SEGMENTS * (per + rest), joints))
    time_s = np.arange(per) * SAMPLE_S
    fade = np.sin(np.pi * np.arange(per) / per) ** 0.5 * np.sin(np.pi * np.arange(per) / per)
    for segment in range(SEGMENTS):
        for joint in range(joints):
            frequency = np.exp(rng.uniform(np.log(0.15), np.log(1.6), 3))
            size = rng.uniform(0.3, 1.0, 3) / np.sqrt(frequency / 0.3)
            phase = rng.uniform(0, 2 * np.pi, 3)
            wave = sum(
                a * np.sin(2 * np.pi * f * time_s + p) for a, f, p in zip(size, frequency, phase, strict=True)
            )
            wave = wave * fade
            first = segment * (per + rest)
            course[first : first + per, joint] = (
                float(rng.uniform(*TRAVEL_RAD)) * wave / max(np.abs(wave).max(), 1e-9)
            )
    return course


def run(
    body: Body,
    goal: FloatArray,
    drives: Mapping[int, Joint],
    *,
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81),
    payload: float = 0.0,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return measured angles, speeds and drive torques at the samples, without noise.

    Joints in `drives` have what is hidden in them; all others are plain position servos.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(body.xml(gravity=gravity, payload=payload))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    # every drive is computed here, at every half of a step
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1:3] = 0.0, 0.0
    kp = np.array([link.kp for link in body.links])
    kv = np.array([link.kv for link in body.links])
    for index, joint in drives.items():
        if joint.two_masses:
            model.dof_armature[index] = 1e-3 * joint.armature
    data = mujoco.MjData(model)
    compensates_gravity = any("gravity-compensation" in joint.sizes for joint in drives.values())
    feedforward = (
        _asked(model, goal)
        if any("dynamics-feedforward" in joint.sizes for joint in drives.values())
        else None
    )

    def accelerations(time_s: float, goal: FloatArray, q: FloatArray, rate: FloatArray) -> FloatArray:
        torque, planned = kp * (goal - q) - kv * rate, np.zeros(len(kp))
        if feedforward is not None:
            planned = feedforward[min(int(time_s / SAMPLE_S), len(feedforward) - 1)]
        if compensates_gravity:
            data.qpos[:], data.qvel[:] = q, 0.0
            mujoco.mj_forward(model, data)
            weight = data.qfrc_bias.copy()
        for index, joint in drives.items():
            known = weight[index] if "gravity-compensation" in joint.sizes else planned[index]
            torque[index] = joint.torque(time_s, goal[index], q[index], rate[index], known)
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, rate, torque
        mujoco.mj_forward(model, data)
        measured: FloatArray = data.qacc.copy()
        return measured

    every = round(SAMPLE_S / STEP_S)
    angles, speeds, torques = (np.zeros_like(goal) for _ in range(3))
    q, rate = np.zeros(len(body.links)), np.zeros(len(body.links))
    for row, held in enumerate(goal):
        for step in range(every):
            time_s = (row * every + step) * STEP_S
            shown = {name: joint.measured(float(q[name])) for name, joint in drives.items()}
            pushed = accelerations(time_s, held, q, rate)
            if step == 0:
                angles[row], speeds[row], torques[row] = q, rate, data.qfrc_applied
                angles[row, list(shown)] = list(shown.values())
            # the midpoint rule: a step that only uses where it begins makes every servo early by half a step
            half = rate + 0.5 * STEP_S * pushed
            middle = accelerations(time_s + 0.5 * STEP_S, held, q + 0.5 * STEP_S * rate, half)
            q, rate = q + STEP_S * half, rate + STEP_S * middle
    if not np.isfinite(angles).all() or np.abs(angles).max() > 6.0:
        raise FloatingPointError("the simulation of the robot diverged")
    return angles, speeds, torques


def _asked(model: Any, goal: FloatArray) -> FloatArray:
    """Return the torques that the motion of the goals asks for, (n, joints): inertia, rates, weight and damping."""
    import mujoco

    data, asked = mujoco.MjData(model), np.zeros_like(goal)
    rates = np.gradient(goal, SAMPLE_S, axis=0)
    for row, (q, rate, push) in enumerate(
        zip(goal, rates, np.gradient(rates, SAMPLE_S, axis=0), strict=True)
    ):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, rate, push
        mujoco.mj_inverse(model, data)
        asked[row] = data.qfrc_inverse
    return asked


MASS_OFF, GAIN_OFF = 0.03, 0.05
"""How far masses and gains of the robot are from its file, relative standard deviation."""
CONTROLS = 0.25
WHOLE = 0.12
"""Share of robots without anything hidden, and of those whose base is tilted or that carry a load."""
GAP = (1.0, 30.0)
NOISE_RAD = (1e-5, 2e-3)
_ATTEMPTS = 12


def make_robot(seed: int, index: int, folder: Path) -> str:
    """Make a robot, write it below `folder`, and return its name; the same for the same seed and index anywhere."""
    rng = np.random.default_rng([seed, 70111, index])
    name = f"case-{index + 1:04d}"
    for _ in range(_ATTEMPTS):
        try:
            answer, files = _made(rng)
        except FloatingPointError:
            continue
        answer.update(case=name, seed=seed, kind="robot")
        (folder / "cases" / name).mkdir(parents=True, exist_ok=True)
        (folder / "sealed").mkdir(parents=True, exist_ok=True)
        for file, text in files.items():
            (folder / "cases" / name / file).write_text(text, encoding="utf-8")
        (folder / "sealed" / f"{name}.json").write_text(json.dumps(answer, indent=1) + "\n", encoding="utf-8")
        return name
    raise RuntimeError(f"case {index} of seed {seed}: no draw of {_ATTEMPTS} could be made")


def _made(rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, str]]:
    stated = draw(rng)
    built = stated.scattered(rng, MASS_OFF, GAIN_OFF)
    goal = goals(rng, len(built.links))
    plain, speeds, torques = run(built, goal, {})
    hidden, whole = _hidden(rng, built, plain, speeds, torques)
    around = {"gravity": whole.get("gravity", (0.0, 0.0, -9.81)), "payload": whole.get("payload", 0.0)}
    course = run(built, goal, _drives(hidden), **around)[0] if hidden or whole else plain
    gaps = {}
    for index in hidden:
        others = {name: joint for name, joint in hidden.items() if name != index}
        without = run(built, goal, _drives(others))[0] if others else plain
        gaps[index] = _gap(built, goal, plain, course[:, index] - without[:, index], index)
    noise = float(np.exp(rng.uniform(np.log(2e-5), np.log(5e-4))))
    if gaps:
        aim = float(np.exp(rng.uniform(*np.log(GAP))))
        noise = float(np.clip(min(gaps.values()) / aim, *NOISE_RAD))
    measured = course + noise * rng.standard_normal(course.shape)
    answer = {
        "robot": stated.name, "joints": len(stated.links), "noise_rad": noise,
        "hidden": [
            {
                "joint": stated.links[name].name, "effect": next(iter(joint.sizes)),
                "size": next(iter(joint.sizes.values())), "gap": gaps[name] / noise,
            }
            for name, joint in hidden.items()
        ],
        "whole": {name: list(value) if isinstance(value, tuple) else value for name, value in whole.items()},
    }  # fmt: skip
    return answer, {"robot.xml": stated.xml(), **_recording(stated, goal, measured)}


def _hidden(
    rng: np.random.Generator, body: Body, plain: FloatArray, speeds: FloatArray, torques: FloatArray
) -> tuple[dict[int, Joint], dict[str, Any]]:
    kind = rng.random()
    if kind < CONTROLS:
        return {}, {}
    if kind < CONTROLS + WHOLE:
        if rng.random() < 0.5:
            roll, pitch = rng.uniform(0.03, 0.1, 2) * rng.choice([-1, 1], 2)
            down = np.array([np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)])
            return {}, {"gravity": tuple(float(value) for value in 9.81 * down)}
        return {}, {"payload": float(rng.uniform(0.3, 1.0)) * body.links[len(body.links) // 2].mass}
    count = min(int(rng.integers(1, 4)), len(body.links))
    payloads = {}
    for index in sorted(int(link) for link in rng.choice(len(body.links), count, replace=False)):
        effect = EFFECTS[int(rng.integers(len(EFFECTS)))]
        torque = float(np.percentile(np.abs(torques[:, index]), 95))
        travel = float(np.percentile(np.abs(plain[:, index]), 95))
        rate = float(np.percentile(np.abs(speeds[:, index]), 99))
        link = body.links[index]
        payloads[index] = Joint(
            link.kp, link.kv, link.armature, 0.5 * STEP_S, rate,
            {effect: draw_size(effect, rng, torque, travel, rate)}, draw_shape(rng),
        )  # fmt: skip
    return payloads, {}


def _drives(hidden: dict[int, Joint]) -> dict[int, Joint]:
    return {
        name: replace(
            joint,
            _late={},
            _motor=None,
            _middle=None,
            _played=None,
            _bristle=0.0,
            _sum=0.0,
            _sum_middle=None,
            _profile=None,
        )
        for name, joint in hidden.items()
    }


def _gap(body: Body, goal: FloatArray, plain: FloatArray, left: FloatArray, joint_index: int) -> float:
    """Return what is left of the change of a joint by its own effect once its servo and mass were adapted, rad."""
    link = body.links[joint_index]
    changed = []
    for other in (
        replace(link, kp=1.02 * link.kp), replace(link, damping=1.2 * link.damping),
        replace(link, mass=1.03 * link.mass),
    ):  # fmt: skip
        links = tuple(other if k == joint_index else link for k, link in enumerate(body.links))
        changed.append(run(replace(body, links=links), goal, {})[0][:, joint_index] - plain[:, joint_index])
    by = np.column_stack(changed)
    left = left - by @ np.linalg.lstsq(by, left, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def _recording(body: Body, goal: FloatArray, measured: FloatArray) -> dict[str, str]:
    """Return a recording, a file a motion; each begins half a rest before its first goal, but for the first."""
    names = [link.name for link in body.links]
    lines = ['experiment = "robot"']
    for name in names:
        lines += [f"[channels.{name}_command]", 'kind = "input"', 'unit = "rad"', 'between = "hold"']
        lines += [f"[channels.{name}]", 'kind = "output"', 'unit = "rad"']
    files = {}
    header = ",".join(["time_s", *(f"{name}_command" for name in names), *names])
    per = len(goal) // SEGMENTS
    lead = round(REST_S / SAMPLE_S / 2)
    for number in range(SEGMENTS):
        rows = slice(max(0, number * per - lead), (number + 1) * per - lead)
        time_s = SAMPLE_S * np.arange(len(goal[rows]))
        table = np.column_stack([time_s, goal[rows], measured[rows]])
        file = f"{number + 1:03d}.csv"
        files[file] = (
            header + "\n" + "".join(",".join(f"{value:.9g}" for value in row) + "\n" for row in table)
        )
        lines += ["[[trials]]", f'file = "{file}"', f'condition = {{ motion = "m{number + 1}" }}']
    return {**files, "recording.toml": "\n".join(lines) + "\n"}
