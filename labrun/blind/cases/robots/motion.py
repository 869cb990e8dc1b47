"""What a robot does: MuJoCo's own stepping in short steps, the drives computed here."""

from collections.abc import Mapping

import numpy as np

from .body import Body, FloatArray
from .hidden import Joint

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
    model.opt.timestep = STEP_S
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    # every drive is computed here, at every step
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1:3] = 0.0, 0.0
    kp = np.array([one.kp for one in body.links])
    kv = np.array([one.kv for one in body.links])
    for place, joint in drives.items():
        if "elastic-transmission" in joint.sizes:
            model.dof_armature[place] = 1e-3 * joint.armature
    data = mujoco.MjData(model)
    every = round(SAMPLE_S / STEP_S)
    rows = len(goal)
    angles, speeds, torques = (np.zeros_like(goal) for _ in range(3))
    for row in range(rows):
        for step in range(every):
            q, rate = data.qpos, data.qvel
            torque = kp * (goal[row] - q) - kv * rate
            if drives:
                for place, joint in drives.items():
                    torque[place] = joint.torque(data.time, goal[row, place], q[place], rate[place])
            if step == 0:
                angles[row], speeds[row], torques[row] = q, rate, torque
                for place, joint in drives.items():
                    angles[row, place] = joint.measured(float(q[place]))
            elif drives:
                for place, joint in drives.items():
                    if "play" in joint.sizes:
                        joint.measured(float(q[place]))
            data.qfrc_applied[:] = torque
            mujoco.mj_step(model, data)
    if not np.isfinite(angles).all() or np.abs(angles).max() > 6.0:
        raise FloatingPointError("the robot left the finite numbers")
    return angles, speeds, torques
