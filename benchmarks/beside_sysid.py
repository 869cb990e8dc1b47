"""Joint by joint beside mujoco.sysid: error on withheld motion, seconds, and what each says, on the same log.

    pip install 'mujoco[sysid]'
    python benchmarks/beside_sysid.py

The log: an arm of two joints with position servos, stepped by MuJoCo at 0.5 ms, with dry friction at the elbow as a
spring of bristles, masses and gains some percent from the file; 8 motions of 4 s at 100 Hz, encoders with 0.2 mrad of
noise. Both see 6 motions; error is the root mean square over the other 2, whole arm simulated from the first sample.

mujoco.sysid fits the parameters that it is given. It is run twice: with masses, gains and damping, as people have them
in the file; and with frictionloss of every joint beside these, as somebody would choose who knows that it is friction.
labrun is told neither.
"""

import resource
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
from mujoco import sysid

from labrun.fit import Dataset, FitTrial
from labrun.gap import Options, RobotDiagnosis, diagnose_robot
from labrun.models import load_model, read_robot, simulate
from labrun.store import SignalInfo
from labrun.workers import cores

XML = """
<mujoco model="arm"><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.4" armature="0.05"/>
<inertial pos="0 0 -0.2" mass="{0}" diaginertia="0.01 0.01 0.01"/>
<body name="lower" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0" damping="0.2" armature="0.02"/>
<inertial pos="0 0 -0.15" mass="{1}" diaginertia="0.005 0.005 0.005"/></body></body></worldbody>
<actuator><position name="shoulder" joint="shoulder" kp="{2}" kv="8"/>
<position name="elbow" joint="elbow" kp="{3}" kv="2"/></actuator>
<sensor><jointpos name="shoulder_pos" joint="shoulder"/><jointpos name="elbow_pos" joint="elbow"/></sensor></mujoco>
"""
STATED, BUILT = (1.5, 0.8, 150.0, 40.0), (1.45, 0.83, 156.0, 38.5)
FRICTION_N_M, NOISE_RAD = 0.25, 2e-4
SAMPLE_S, SAMPLES, MOTIONS, SEEN = 0.01, 400, 8, 6
JOINTS, BODIES = ("shoulder", "elbow"), ("upper", "lower")


def recorded() -> list[tuple[np.ndarray, np.ndarray]]:
    """Return goals and measured angles of every motion."""
    rng = np.random.default_rng(3)
    model = mujoco.MjModel.from_xml_string(XML.format(*BUILT))
    model.opt.timestep = 5e-4
    time_s, fade = np.arange(SAMPLES) * SAMPLE_S, np.sin(np.pi * np.arange(SAMPLES) / SAMPLES) ** 1.5
    made = []
    for _ in range(MOTIONS):
        data, bristle = mujoco.MjData(model), 0.0
        frequency, phase = rng.uniform(0.3, 1.5, (2, 2)), rng.uniform(0, 6, (2, 2))
        goals = (
            0.35 * fade[:, None] * np.sin(2 * np.pi * time_s[:, None, None] * frequency + phase).sum(axis=2)
        )
        angles = np.empty_like(goals)
        for row in range(SAMPLES):
            angles[row] = data.qpos
            for _ in range(20):
                bristle = float(np.clip(bristle + 5e-4 * data.qvel[1] / 2e-4, -1, 1))
                data.ctrl[:], data.qfrc_applied[1] = goals[row], -FRICTION_N_M * bristle
                mujoco.mj_step(model, data)
        made.append((goals, angles + NOISE_RAD * rng.standard_normal(angles.shape)))
    return made


def by_labrun(motions: list[tuple[np.ndarray, np.ndarray]]) -> tuple[RobotDiagnosis, float]:
    """Diagnose the seen motions; return what was found and the error on the others."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "arm.xml"
        file.write_text(XML.format(*STATED), encoding="utf-8")
        robot, model = read_robot(file), load_model(file)
    time_s = np.arange(SAMPLES) * SAMPLE_S
    trials = tuple(
        FitTrial(f"motion {k}", {"motion": f"m{k}"}, 1, time_s, *motion)
        for k, motion in enumerate(motions[:SEEN])
    )
    inputs = tuple(SignalInfo(signal.name, signal.unit, "hold") for signal in model.inputs)
    outputs = tuple(SignalInfo(output.name, output.unit) for output in model.outputs)
    dataset = Dataset("arm", Path("arm"), "recording", inputs, outputs, trials)
    diagnosis = diagnose_robot(robot, model, dataset, Options(workers=cores()))
    corrected = model.with_values(diagnosis.values).with_effects(diagnosis.effects)
    columns = [[output.name for output in model.outputs].index(name) for name in JOINTS]
    left = []
    for goals, angles in motions[SEEN:]:
        begin = np.array(
            [dict(zip(JOINTS, angles[0], strict=True)).get(state, 0.0) for state in model.states]
        )
        made = simulate(corrected, time_s, goals, initial_state=begin, substeps=4)
        left.append(made.outputs[:, columns] - angles)
    return diagnosis, float(np.sqrt(np.mean(np.square(left))))


def by_sysid(
    motions: list[tuple[np.ndarray, np.ndarray]], *, friction: bool
) -> tuple[dict[str, float], float]:
    """Fit the seen motions; return the parameters and the error on the others."""
    spec = mujoco.MjSpec.from_string(XML.format(*STATED))
    model = spec.compile()
    params = sysid.ParameterDict()

    def add(name: str, stated: float, low: float, high: float, modifier: object) -> None:
        params.add(sysid.Parameter(name, nominal=stated, min_value=low, max_value=high, modifier=modifier))

    for body, joint, mass, kp in zip(BODIES, JOINTS, STATED[:2], STATED[2:], strict=True):
        add(f"{body}_mass", mass, 0.7 * mass, 1.3 * mass,
            lambda s, p, n=body: setattr(s.body(n), "mass", p.value[0]))  # fmt: skip
        add(f"{joint}_kp", kp, 0.7 * kp, 1.3 * kp,
            lambda s, p, n=joint: sysid.apply_pgain(s, n, p.value[0]))  # fmt: skip
        damping = float(np.ravel(model.joint(joint).damping)[0])
        add(f"{joint}_damping", damping, 0.0, 10.0,
            lambda s, p, n=joint: setattr(s.joint(n), "damping", _like(s.joint(n).damping, p.value[0])))  # fmt: skip
        if friction:
            add(f"{joint}_frictionloss", 0.01, 0.0, 2.0,
                lambda s, p, n=joint: setattr(s.joint(n), "frictionloss", p.value[0]))  # fmt: skip
    step = model.opt.timestep
    every = round(SAMPLE_S / step)
    sequences = []
    for k, (goals, angles) in enumerate(motions[:SEEN]):
        fine = np.arange(SAMPLES * every) * step
        control = sysid.TimeSeries(fine, np.repeat(goals, every, axis=0))
        sensor = sysid.TimeSeries.from_names(np.arange(SAMPLES) * SAMPLE_S, angles, model)
        begin = sysid.create_initial_state(model, angles[0], np.zeros(2), np.empty(0))
        sequences.append(sysid.ModelSequences("arm", spec, f"motion {k}", begin, control, sensor))
    fitted, _ = sysid.optimize(params, sysid.build_residual_fn(models_sequences=sequences), verbose=False)
    model = sysid.apply_param_modifiers(fitted, mujoco.MjSpec.from_string(XML.format(*STATED)))
    left = []
    for goals, angles in motions[SEEN:]:
        data = mujoco.MjData(model)
        data.qpos[:] = angles[0]
        for row in range(SAMPLES - 1):
            data.ctrl[:] = goals[row]
            mujoco.mj_step(model, data, nstep=every)
            left.append(data.sensordata - angles[row + 1])  # as it compares: a sensor shows the step before
    return {name: float(fitted[name].value[0]) for name in fitted.parameters}, float(
        np.sqrt(np.mean(np.square(left)))
    )


def _like(old: object, value: float) -> object:
    """Return the value in the shape that this MuJoCo keeps damping in: newer ones have polynomials."""
    shaped = np.array(old, dtype=float)
    if shaped.ndim == 0:
        return value
    shaped[0] = value
    return shaped


def _since(began: tuple[float, float]) -> str:
    wall, processor = (now - then for now, then in zip(_clocks(), began, strict=True))
    return f"{wall:.1f} s, {processor:.1f} s of processors"


def _clocks() -> tuple[float, float]:
    """Return seconds on the wall, and of processors with those of processes that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return time.perf_counter(), sum(getrusage.ru_utime + getrusage.ru_stime for getrusage in used)


if __name__ == "__main__":
    log = recorded()
    for friction in (False, True):
        began = _clocks()
        values, error = by_sysid(log, friction=friction)
        message = ", ".join(f"{name} {value:.4g}" for name, value in values.items())
        print(f"mujoco.sysid{' with frictionloss' if friction else '':<18} {1e3 * error:.3f} mrad"
              f"  {_since(began)}  {message}")  # fmt: skip
    began = _clocks()
    answer, error = by_labrun(log)
    for joint in answer.joints:
        steps = " > ".join(
            f"{1e3 * error:.3f}" for error in (joint.stated, joint.recalibrated, joint.corrected)
        )
        print(f"  {joint.joint.name}, motions that were seen: {steps} mrad")
    print(f"labrun{'':<24} {1e3 * error:.3f} mrad  {_since(began)}  {answer.sentence}")
    print(f"noise of the encoders {1e3 * NOISE_RAD:.3f} mrad")
