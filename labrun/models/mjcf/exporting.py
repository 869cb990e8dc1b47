"""A corrected robot as MJCF that MuJoCo simulates alone, and what of the correction MJCF has no word for."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect
from labrun.errors import ModelError
from labrun.models.mjcf.model import MujocoModel
from labrun.models.mjcf.plant import imported, plant
from labrun.models.mjcf.robot import GRAVITY_HELD_AT_LEAST, mjcf_text, robot_spec, samples_of_delay
from labrun.models.model import Model

_SHORTEST_STEP_S = 1e-4
"""Timestep down to which an exported delay holds: shorter than robots are simulated with, and little to keep."""
_KNEE = "its corner is sharp in MuJoCo"


@dataclass(frozen=True)
class Exported:
    """A robot for other simulators.

    Attributes
    ----------
    written
        What of the correction is in it, and where; sentences.
    left
        What is not, with its law and values; sentences.
    passive : (joint, effect)
        Those of them that `labrun.models.passive_forces` makes a callback of.
    """

    xml: str
    written: tuple[str, ...]
    left: tuple[str, ...]
    passive: tuple[tuple[str, AttachedEffect], ...] = ()


def mjcf_of(model: Model) -> Exported:
    """Return a model with its values and effects as MJCF.

    Raises
    ------
    ModelError
        It is no model in MuJoCo, depends on conditions, or a value cannot be said in MJCF.
    """
    if not isinstance(model, MujocoModel):
        raise ModelError(
            f"{model.name} is not a model in MuJoCo, so it has no MJCF to write", hint="see Add a model"
        )
    if model.conditions:
        raise ModelError(
            f"{model.name} depends on the condition {', '.join(model.conditions)}",
            hint="give it a value in the model",
        )
    mujoco = imported()
    spec = (
        mujoco.MjSpec.from_string(model.mjcf)
        if model.mjcf.lstrip().startswith("<")
        else robot_spec(Path(model.mjcf))[0]
    )
    compiled = spec.compile()
    written = _write_values(model, compiled)
    try:
        spec.copy_back(compiled)
    except ValueError as error:
        raise ModelError(f"MJCF cannot express a value of {model.name}: {error}") from None
    for body in spec.bodies:  # MuJoCo does not copy it back
        share = float(compiled.body_gravcomp[compiled.body(body.name).id])
        body.gravcomp = share if abs(share) > GRAVITY_HELD_AT_LEAST else 0.0
    left: list[str] = []
    passive: list[tuple[str, AttachedEffect]] = []
    for effect in model.effects:
        message = _write(spec, compiled, model, effect)
        if message is not None:
            written.append(message)
            continue
        left.append(_law(effect))
        if effect.effect.kind == "joint" and not effect.effect.needs_acceleration:
            passive.append((_joint_of(spec, compiled, model, effect).name, effect))
            left[-1] += "; labrun.models.passive_forces makes a callback of it"
    delays = [actuator for actuator in spec.actuators if getattr(actuator, "nsample", 0)]
    if delays:
        step_s = float(compiled.opt.timestep)
        spec.comment = " ".join(
            [f"delay of actuator {actuator.name}: {actuator.delay:.6g} s." for actuator in delays]
            + [
                f"nsample holds it at timesteps of {_shortest_step_s(step_s):g} s and more; at a shorter one MuJoCo "
                "cuts the delay off: set nsample to delay/timestep + 2."
            ]
        )
    spec.compile()
    return Exported(mjcf_text(spec), tuple(written), tuple(left), tuple(passive))


def _write_values(model: MujocoModel, compiled: Any) -> list[str]:
    """Write a model's values into the compiled description; return where they stand, as sentences."""
    corrected = _with_values(model)
    written, masses = [], compiled.body_mass.copy()
    held_bodies: dict[str, float] = {}
    for _, memory in model.layout.settings:
        before, after = memory.read(compiled), memory.read(corrected)
        if before != after:
            memory.write(compiled, after)
            if memory.array == "body_gravcomp":
                held_bodies[_named(corrected, memory.array, memory.index)[0]] = after
            elif not _goes_along(
                memory.array, memory.index, after / before if before else 0.0, masses, corrected
            ):
                element = _named(corrected, memory.array, memory.index)[0] if memory.owner == "model" else ""
                where = f"{memory.array} of {element}" if element else f"{memory.array}[{memory.index}]"
                written.append(f"{where}: {before:.6g} became {after:.6g}")
    return [*written, *_held_told(held_bodies)]


def _held_told(shares: Mapping[str, float]) -> list[str]:
    """Return the shares of their weight by which bodies are held, as sentences."""
    bodies: dict[float, list[str]] = {}
    for body, share in shares.items():
        bodies.setdefault(share, []).append(body)
    return [
        f"gravity compensation of {share:.6g} is gravcomp of {', '.join(names)}"
        for share, names in bodies.items()
    ]


def _with_values(model: MujocoModel) -> Any:
    """Return MuJoCo's model with the parameters' values in it: written there by what the simulation runs."""
    p = model.vector(None, {})
    counts = (len(model.states), len(model.inputs), len(model.sites), len(model.states))
    x, u, force, out = (np.zeros(max(1, count)) for count in counts)
    for index, (_, rule) in enumerate(model.initial.items()):
        x[index] = rule if isinstance(rule, float) else 0.0
    model.derivative.python(0.0, x, u, p, force, out)
    return plant(model.layout).model


def _write(spec: Any, compiled: Any, model: MujocoModel, effect: AttachedEffect) -> str | None:
    """Write an effect; return where it stands, or None if MJCF has no word for it."""
    values = effect.named_values
    if effect.effect.kind == "joint":
        joint = _joint_of(spec, compiled, model, effect)
        if effect.effect.id == "constant-force":
            return _constant_force(spec, joint, values["force"])
        if effect.effect.id in _STOPS:
            return _stop(compiled, joint, *_STOPS[effect.effect.id](values))
        return _JOINT[effect.effect.id](joint, values) if effect.effect.id in _JOINT else None
    if effect.effect.kind == "input":
        signal = model.layout.inputs[[port.name for port in model.inputs].index(effect.site)]
        if signal.array == "ctrl" and effect.effect.id in _INPUT:
            return _INPUT[effect.effect.id](spec.actuators[signal.index], values, compiled)
    return None


def _joint_of(spec: Any, compiled: Any, model: MujocoModel, effect: AttachedEffect) -> Any:
    """Return the joint of a description that an effect sits at."""
    memory = model.layout.sites[[site.name for site in model.sites].index(effect.site)]
    return spec.joints[int(compiled.dof_jntid[memory.index])]


def _constant_force(spec: Any, joint: Any, force: float) -> str:
    """Write a force that never changes: into the bias of the joint's drive, or as an actuator of its own."""
    mujoco = imported()
    for actuator in spec.actuators:
        alone = actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT and actuator.target == joint.name
        known = actuator.biastype in (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)
        if alone and known and actuator.gear[0] and not any(actuator.forcerange):
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.biasprm[0] += force / actuator.gear[0]
            return f"a constant force of {force:.6g} is in biasprm of actuator {actuator.name}"
    own = spec.add_actuator(name=f"{joint.name}_constant_force", target=joint.name)
    own.trntype, own.gaintype = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtGain.mjGAIN_FIXED
    own.gainprm[0], own.biastype = 0.0, mujoco.mjtBias.mjBIAS_AFFINE
    own.biasprm[0] = force
    return (
        f"a constant force of {force:.6g} is biasprm of a new actuator {own.name}; its control, the last one, does "
        "nothing"
    )


_STOPS: Mapping[str, Callable[[Mapping[str, float]], tuple[float, float, float, float]]] = {
    "end-stop": lambda values: (
        values["lower"],
        values["upper"],
        values["stiffness"],
        values["stiffness"] * values["damping_time"],
    ),
    "asymmetric-stiffness": lambda values: (-np.inf, 0.0, values["excess"], 0.0),
}
"""Springs on one side: where they begin below and above, stiffness, damping for each rad (m) that they are pressed."""
_IMPEDANCE = 1e-3
"""Impedance of a limit that is a spring: so low that its force adds to the others instead of replacing them."""
_FAR = 1e6
"""End of a range, rad or m, that no joint reaches."""


def _stop(
    compiled: Any, joint: Any, lower: float, upper: float, stiffness: float, damping: float
) -> str | None:
    """Write a spring on one side as a limit; None where it pulls, or the joint has limits already.

    With a low impedance d, the limit's force is its reference acceleration, stiffness/d times depth, over its
    regularisation, the joint's inverse inertia as compiled over d (MuJoCo, Computation, Solver parameters): what the
    joint carries cancels.
    """
    number = compiled.joint(joint.name).id
    if stiffness <= 0.0 or compiled.jnt_limited[number]:
        return None
    dof = int(compiled.jnt_dofadr[number])
    mobility = float(np.ravel(compiled.dof_invweight0)[dof])
    reach = upper - lower if np.isfinite([lower, upper]).all() else 1.0
    joint.limited = 1
    joint.range = [max(lower, -_FAR), min(upper, _FAR)]
    joint.solref_limit = [-stiffness * mobility, -max(damping * reach * mobility, 1e-9)]
    joint.solimp_limit = [_IMPEDANCE, _IMPEDANCE, 1e-3, 0.5, 2.0]
    ends = " and ".join(f"{end:.6g}" for end in (lower, upper) if np.isfinite(end))
    return f"a spring of {stiffness:.6g} beyond {ends} is range and solreflimit of joint {joint.name}"


def _coulomb(joint: Any, values: Mapping[str, float]) -> str:
    joint.frictionloss += values["torque"]
    return (
        f"Coulomb friction of {values['torque']:.6g} is frictionloss of joint {joint.name}; in MuJoCo it "
        "holds still, where labrun's law creeps"
    )


def _viscous(joint: Any, values: Mapping[str, float]) -> str:
    joint.damping[0] += values["coefficient"]
    return f"viscous damping of {values['coefficient']:.6g} is in damping of joint {joint.name}"


def _quadratic(joint: Any, values: Mapping[str, float]) -> str:
    joint.damping[1] += values["coefficient"]
    return (
        f"quadratic drag of {values['coefficient']:.6g} is the second number of damping of joint {joint.name}"
    )


def _inertia(joint: Any, values: Mapping[str, float]) -> str | None:
    if joint.armature + values["inertia"] < 0:
        return None
    joint.armature += values["inertia"]
    return f"added inertia of {values['inertia']:.6g} is in armature of joint {joint.name}"


def _rest(joint: Any, values: Mapping[str, float]) -> str:
    joint.springref += values["offset"]
    return f"a rest offset of {values['offset']:.6g} is in springref of joint {joint.name}"


_JOINT: Mapping[str, Callable[[Any, Mapping[str, float]], str | None]] = {
    "coulomb-friction": _coulomb, "viscous-damping": _viscous, "quadratic-drag": _quadratic,
    "added-inertia": _inertia, "rest-offset": _rest,
}  # fmt: skip


def _shortest_step_s(step_s: float) -> float:
    return min(step_s, _SHORTEST_STEP_S)


def _delay(actuator: Any, values: Mapping[str, float], compiled: Any) -> str:
    step_s = float(compiled.opt.timestep)
    actuator.delay = values["delay"]
    shortest_s = _shortest_step_s(step_s)
    actuator.nsample = samples_of_delay(values["delay"], shortest_s)
    where = f"delay of actuator {actuator.name}, at timesteps of {shortest_s:g} s and more"
    return f"a delay of {1e3 * values['delay']:.4g} ms is {where}"


def _gain(actuator: Any, values: Mapping[str, float], _: Any) -> str:
    actuator.gainprm[0] *= 1 + values["error"]
    return f"a gain {100 * values['error']:+.4g} % off is in gainprm of actuator {actuator.name}"


def _bias(actuator: Any, values: Mapping[str, float], _: Any) -> str:
    actuator.biasprm[0] += actuator.gainprm[0] * values["offset"]
    actuator.biastype = imported().mjtBias.mjBIAS_AFFINE
    return f"a bias of {values['offset']:.6g} is in biasprm of actuator {actuator.name}"


def _lag(actuator: Any, values: Mapping[str, float], _: Any) -> str | None:
    mujoco = imported()
    if actuator.dyntype != mujoco.mjtDyn.mjDYN_NONE:
        return None
    actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
    actuator.dynprm[0] = values["time_constant"]
    actuator.actlimited = 0
    return f"a lag of {values['time_constant']:.6g} s is dynprm of actuator {actuator.name}"


def _saturation(actuator: Any, values: Mapping[str, float], _: Any) -> str:
    actuator.ctrlrange = [-values["level"], values["level"]]
    actuator.ctrllimited = 1
    knee = f"; {_KNEE}" if values.get("knee", 0.0) > 0 else ""
    return f"a saturation at {values['level']:.6g} is ctrlrange of actuator {actuator.name}{knee}"


_INPUT: Mapping[str, Callable[[Any, Mapping[str, float], Any], str | None]] = {
    "delay": _delay, "gain-error": _gain, "bias": _bias, "lag": _lag, "saturation": _saturation,
}  # fmt: skip


def _law(effect: AttachedEffect) -> str:
    """Say what MJCF cannot, so that it can be put into a passive callback."""
    values = ", ".join(f"{name} = {value:.6g}" for name, value in effect.named_values.items())
    form = getattr(effect.effect, "form", "")
    where = (
        "is a clock of the log, and no part of the robot"
        if effect.effect.ahead
        else "belongs to the sensor, not to the robot"
        if effect.effect.kind == "output"
        else "has no word in MJCF"
    )
    return f"{effect.effect.id} at {effect.site} {where}: {form}{' with ' if form else ''}{values}"


@dataclass(frozen=True)
class MjcfRange:
    """What an interval of a parameter is in MJCF.

    Attributes
    ----------
    parameter
    array, element
        The field of MuJoCo's model, and the name of the joint, body or actuator.
    joint
        What an actuator drives; the joint itself; "" for a body.
    value, low, high
        The number there.
    """

    parameter: str
    array: str
    element: str
    joint: str
    value: float
    low: float
    high: float

    def to_json(self) -> dict[str, float | str]:
        """Return the fields by name."""
        return asdict(self)


def mjcf_ranges(model: Model, intervals: Mapping[str, tuple[float, float, float]]) -> list[MjcfRange]:
    """Return which numbers of MJCF the parameters' values and intervals are.

    Parameters
    ----------
    intervals : parameter -> (value, low, high)
    """
    if not isinstance(model, MujocoModel):
        raise ModelError(f"{model.name} is not a model in MuJoCo, so it has no MJCF to write")
    ranges = []
    for name, numbers in intervals.items():
        courses, masses = [], []
        for value in numbers:
            native = _with_values(replace(model, parameters=model.with_values({name: value}).parameters))
            courses.append([memory.read(native) for _, memory in model.layout.settings])
            masses.append(native.body_mass.copy())
        for (_, memory), middle, low, high in zip(model.layout.settings, *courses, strict=True):
            factor = high / low if low else 0.0
            if low != high and not _goes_along(memory.array, memory.index, factor, masses[1], native):
                element, joint = _named(native, memory.array, memory.index)
                ends = sorted((low, high))
                ranges.append(MjcfRange(name, memory.array, element, joint, middle, ends[0], ends[1]))
    return ranges


def _goes_along(array: str, index: int, factor: float, masses: FloatArray, changed: Any) -> bool:
    """Tell whether a number follows from another one: a servo's bias from its gain, an inertia from its mass."""
    if array == "actuator_biasprm":
        return True
    body = index // 3
    return array == "body_inertia" and bool(np.isclose(factor, changed.body_mass[body] / masses[body]))


def _named(native: Any, array: str, index: int) -> tuple[str, str]:
    """Return the element that a number belongs to, and its joint."""
    mujoco = imported()
    kinds, field = mujoco.mjtObj, np.asarray(getattr(native, array))
    row = index // (field.shape[1] if field.ndim > 1 else 1)
    kind = array.partition("_")[0]
    if kind == "dof":
        name = mujoco.mj_id2name(native, kinds.mjOBJ_JOINT, int(native.dof_jntid[row])) or ""
        return name, name
    if kind == "actuator":
        joint = mujoco.mj_id2name(native, kinds.mjOBJ_JOINT, int(native.actuator_trnid[row, 0])) or ""
        return mujoco.mj_id2name(native, kinds.mjOBJ_ACTUATOR, row) or "", joint
    type_ = {"body": kinds.mjOBJ_BODY, "jnt": kinds.mjOBJ_JOINT, "geom": kinds.mjOBJ_GEOM}.get(kind)
    return (mujoco.mj_id2name(native, type_, row) or "" if type_ is not None else ""), ""
