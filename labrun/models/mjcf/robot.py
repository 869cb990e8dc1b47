"""A robot model from an MJCF or URDF file: inputs, outputs, and a site at every joint."""

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, Literal

import numpy as np

from labrun.errors import ModelError
from labrun.models.finding import model_files_like
from labrun.models.mjcf.plant import imported
from labrun.models.mjcf.soundness import check_inertias, require_links
from labrun.toml import suggest

_REFERENCE = "what each element takes: https://mujoco.readthedocs.io/en/stable/XMLreference.html"
_MEANT = {
    "bad format": "numbers have a point, no comma, and a space between them",
    "Error opening file": "a file is looked for beside the one that names it: put it there, or leave the line out",
    "larger than mjMINVAL": "a body that a joint moves has a mass: give it <inertial> with pos, mass and diaginertia",
    "A + B >= C": "no body has such moments of inertia: none is more than the other two together; look at units",
}
"""What to do about complaints that name no word of the file."""
_SCHEMA_LINE = re.compile(r"^ *((?:\(world\))?\w+) \([!?*R]\) *(.*)$")
_CLOSED = re.compile(r"XML_ERROR_MISMATCHED_ELEMENT.* name=(\w+)")


def refusal(path: Path, error: ValueError, *, doing: str = "read") -> ModelError:
    """Return MuJoCo's error with its line, and the nearest known word to an unknown one."""
    what, _, rest = str(error).strip().partition("\n")
    what = re.sub(r"^(XML )?Error: (Schema violation: )?", "", what)
    closed = _CLOSED.search(rest)
    if closed:
        what = f"<{closed[1]}> is not closed, or closed by another name"
    line = re.search(r"[Ll]ine(?: number=)? ?(\d+)", f"{rest} {what}")
    element = re.search(r"Element '([^']*)'", rest)
    where = f", line {line[1]}" if line else ""
    of = f" (element {element[1]})" if element else f" ({rest})" if rest and not line else ""
    return ModelError(f"MuJoCo cannot {doing} {path}{where}: {what}{of}", hint=_hint(path, what, element))


def _hint(path: Path, what: str, element: "re.Match[str] | None") -> str:
    attributes = _attributes()
    if element and "unrecognized element" in what:
        return suggest(element[1], attributes, kind="elements")
    wrong = re.search(r"'([^']+)'", what)
    if element and wrong and "unrecognized attribute" in what:
        return suggest(wrong[1], attributes.get(element[1], ()), kind=f"attributes of {element[1]}")
    if wrong and re.search(r"unknown|not found", what):
        text = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
        names = dict.fromkeys(re.findall(r'\bname\s*=\s*"([^"]+)"', text))
        return suggest(wrong[1], names, kind="names in the file")
    return next((hint for part, hint in _MEANT.items() if part in what), _REFERENCE)


def _attributes() -> dict[str, list[str]]:
    """Return the attributes of every element that MuJoCo knows."""
    names: dict[str, list[str]] = {}
    last: list[str] = []
    for text in imported().mj_printSchema(False, False).splitlines():
        match = _SCHEMA_LINE.match(text)
        if match:
            last = names.setdefault(match[1].removeprefix("(world)"), [])
            if match[1].startswith("("):
                names["worldbody"] = last
        last += (match[2] if match else text).split()
    return names


EDITS_ROBOTS = (4, 0)
"""The MuJoCo that writes values back into a description (`MjSpec.copy_back`); model files need only 3.2."""
Command = Literal["position", "velocity", "torque", "geared", "other"]
"""What a control is: a goal, a torque at the joint, what a gear or gain makes one of, or neither."""
Drive = Literal["position", "torque"]
SERVO_HZ = 5.0
SERVO_DAMPING = 0.8
"""A servo of which nothing is known starts as a second-order follower of this bandwidth and damping ratio (chosen)."""
SERVO_ROTOR = 1.0
"""Its rotor behind the gear, in units of the inertia that the joint carries: the ratio of a matched gear."""
GRAVITY_HELD_AT_LEAST = 1e-9
"""Share of its weight by which every body is held: MuJoCo computes no gravity compensation where all shares are 0."""
_SUFFIX: Mapping[Command, str] = {
    "position": "command", "velocity": "rate_command", "torque": "torque", "geared": "control", "other": "control",
}  # fmt: skip


@dataclass(frozen=True)
class RobotJoint:
    """A hinge or slide.

    Attributes
    ----------
    output
        Its position among the model's outputs.
    unit
        ``"rad"``, of a slide ``"m"``.
    range
        Lowest and highest position, in `unit`; None where the file gives none.
    sprung
        Whether a spring of its own pulls it back.
    """

    name: str
    output: str
    unit: str
    range: tuple[float, float] | None
    sprung: bool = False


@dataclass(frozen=True)
class RobotActuator:
    """An actuator.

    Attributes
    ----------
    name
        In the file; a servo that was added is called after its joint.
    input
        Its control among the model's inputs.
    joint
        What it drives; "" where that is a tendon or a site.
    command
        What its control means.
    unit
    added
        Whether it stands for a servo or motor that the file says nothing of.
    """

    name: str
    input: str
    joint: str
    command: Command
    unit: str
    added: bool = False


@dataclass(frozen=True)
class Robot:
    """A robot as MuJoCo reads it, without meshes and contacts.

    Attributes
    ----------
    name
    xml
        MJCF that needs no other file.
    joints, actuators
    remarks
        What of the file is left out, or was added; sentences.
    bodies
        Those with a name that equations can use.
    sensors
        Names of its force and torque sensors.
    """

    name: str
    xml: str
    joints: tuple[RobotJoint, ...]
    actuators: tuple[RobotActuator, ...]
    remarks: tuple[str, ...]
    bodies: tuple[str, ...]
    sensors: Mapping[str, tuple[str, ...]]

    @property
    def is_told_torques(self) -> bool:
        """Whether all drives take torques, so that the log holds torques or motor currents."""
        return bool(self.actuators) and all(drive.command in ("torque", "geared") for drive in self.actuators)


def read_robot(
    path: Path, drives: Mapping[str, Drive] | Literal["undriven"] | None = None, *, repair: bool = False
) -> Robot:
    """Read an MJCF or URDF file.

    Meshes that are missing, and contacts, are left out; what is left out is said in the remarks.

    Parameters
    ----------
    path
        The file; it may include others.
    drives
        Joints that get an actuator: a position servo of unknown gains, or a torque; ``"undriven"``: a servo for every
        joint that nothing drives.
    repair
        Whether an inertia that no body can have is replaced by the nearest possible one.

    Raises
    ------
    ModelError
        MuJoCo is not installed or cannot read the file, a body's mass would have come from a missing mesh, or no body
        can have an inertia of the file.
    """
    mujoco = imported()
    spec, remarks = robot_spec(path)
    remarks += check_inertias(spec, path, repair=repair)
    model = _compile(spec, path)
    _without_assets(spec, path, ())
    if np.any(model.geom_contype) or np.any(model.geom_conaffinity) or model.npair:
        remarks.append("contacts are switched off: what touches something is outside of this model")
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    remarks += _take_out_delays(spec)
    for body in spec.bodies[1:]:
        body.gravcomp = body.gravcomp or GRAVITY_HELD_AT_LEAST
    for number, joint in enumerate(spec.joints):
        joint.name = joint.name or f"joint{number}"
    for number, actuator in enumerate(spec.actuators):
        actuator.name = actuator.name or actuator.target or f"actuator{number}"
    kinds = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
    simple = [joint for joint in spec.joints if joint.type in kinds]
    remarks += _not_compared([joint for joint in spec.joints if joint.type not in kinds])
    driven = {actuator.target for actuator in spec.actuators if actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT}
    wanted: Mapping[str, Drive]
    if drives == "undriven":
        wanted = {joint.name: "position" for joint in simple if joint.name not in driven}
    else:
        wanted = drives or {}
    unknown = set(wanted) - {joint.name for joint in simple}
    if unknown:
        raise ModelError(f"{path} has no hinge or slide {', '.join(sorted(unknown))} that could be driven")
    added = _add_actuators(spec, model, wanted)
    for kind, words in (("position", "a position servo of unknown gains"), ("torque", "a torque")):
        names = [name for name, wanted_kind in wanted.items() if wanted_kind == kind]
        if names:
            remarks.append(f"{', '.join(names)}: the file has no actuator there; {words} was added")
    model = _compile(spec, path)
    if model.neq:
        kept = "1 equality constraint is" if model.neq == 1 else f"{model.neq} equality constraints are"
        remarks.append(f"{kept} kept; MuJoCo holds them softly")
    joints = _joints(mujoco, simple, model)
    actuators = _actuators(mujoco, spec, joints, added)
    remarks += _crossed(actuators, joints)
    return Robot(
        name=re.sub(r"[^A-Za-z0-9_-]", "-", spec.modelname or path.stem),
        xml=mjcf_text(spec),
        joints=joints,
        actuators=actuators,
        remarks=tuple(remarks),
        bodies=tuple(
            body.name for body in spec.bodies[1:] if body.name and identifier(body.name) == body.name
        ),
        sensors={
            kind: tuple(sensor.name for sensor in spec.sensors if sensor.name and sensor.type == type_)
            for kind, type_ in (
                ("force", mujoco.mjtSensor.mjSENS_FORCE),
                ("torque", mujoco.mjtSensor.mjSENS_TORQUE),
            )
        },
    )


def _take_out_delays(spec: Any) -> list[str]:
    """Remove the delays of actuators from a description; return remarks."""
    remarks = []
    for actuator in spec.actuators:
        if not getattr(actuator, "nsample", 0):
            continue
        remarks.append(
            f"the delay of actuator {actuator.name} is taken out; the effect delay can stand for it"
        )
        needed = samples_of_delay(actuator.delay, spec.option.timestep)
        if actuator.nsample < needed:
            remarks.append(
                f"nsample of actuator {actuator.name} is {actuator.nsample}: at the file's timestep of "
                f"{spec.option.timestep:g} s MuJoCo cuts its delay of {actuator.delay:g} s off; set nsample to {needed}"
            )
        actuator.nsample, actuator.delay = 0, 0.0
    return remarks


def samples_of_delay(delay_s: float, step_s: float) -> int:
    """Return how many samples of a control MuJoCo has to keep for a delay; with fewer it cuts the delay off."""
    return max(2, int(np.ceil(delay_s / step_s - 1e-9)) + 1)


def _not_compared(others: list[Any]) -> list[str]:
    """Return remarks on joints that are neither hinges nor slides."""
    if not others:
        return []
    names = ", ".join(joint.name for joint in others)
    messages = [f"{names}: ball and free joints move, but have no site and are not compared with a log"]
    if any(joint.type == imported().mjtJoint.mjJNT_FREE for joint in others):
        messages.append(
            "nothing holds its free base: with contacts switched off it falls; take the free joint out for a log of a "
            "robot whose base stood still"
        )
    return messages


def mjcf_text(spec: Any) -> str:
    """Return a description as MJCF that MuJoCo 3 reads as well.

    MuJoCo 4 notes with an actuator what its control means, which nothing simulated depends on and MuJoCo 3 refuses.
    """
    return re.sub(r'(<general [^>]*?) input="\w+"', r"\1", spec.to_xml())


def robot_spec(path: Path) -> tuple[Any, list[str]]:
    """Return the MuJoCo specification of a file, and the missing meshes and textures left out.

    Raises ModelError: there is no such file, MuJoCo cannot read it, or MuJoCo is too old to edit it.
    """
    mujoco = imported()
    if tuple(int(part) for part in mujoco.__version__.split(".")[:2]) < EDITS_ROBOTS:
        raise ModelError(
            f"reading a robot file needs MuJoCo {'.'.join(map(str, EDITS_ROBOTS))}, found {mujoco.__version__}",
            hint="pip install --upgrade mujoco",
        )
    if not path.is_file():
        like = model_files_like(path)
        hint = suggest(str(path), like) if like else f"looked from {Path.cwd()}"
        raise ModelError(f"cannot find the robot file {path}", hint=hint)
    require_links(path)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise refusal(path, error) from None
    missing = sorted({_called(mesh) for mesh in spec.meshes if _is_missing(spec, path, "meshdir", mesh.file)})
    pictures = [("texturedir", texture) for texture in spec.textures] + [
        ("meshdir", hfield) for hfield in (*spec.hfields, *spec.skins)
    ]
    if not missing and not any(_is_missing(spec, path, folder, texture.file) for folder, texture in pictures):
        return spec, []
    remarks = _without_assets(spec, path, missing)
    if missing:
        count = "1 mesh is" if len(missing) == 1 else f"{len(missing)} meshes are"
        remarks.insert(0, f"{count} missing, and not needed: {', '.join(missing[:3])}")
    return spec, remarks


def _called(mesh: Any) -> str:
    return str(mesh.name or Path(mesh.file).stem)


def _is_missing(spec: Any, path: Path, folder: str, file: str) -> bool:
    named = Path(file).name if spec.strippath else file
    return bool(file) and not (path.parent / (getattr(spec, folder) or "") / named).is_file()


def _without_assets(spec: Any, path: Path, missing: Collection[str]) -> list[str]:
    """Take out meshes, height fields, skins and textures; what meshes that are there weigh stays, as inertials.

    Raises ModelError: a moving body's mass would have come from a mesh that is missing.
    """
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for picture in [*spec.textures, *spec.skins]:
        spec.delete(picture)
    from_geoms = spec.compiler.inertiafromgeom == imported().mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    remarks, lost = [], []
    for body in spec.bodies[1:]:
        weighing = [geom for geom in body.geoms if 0.0 not in (geom.mass, geom.density)]
        if not from_geoms and (body.explicitinertial or not any(geom.meshname for geom in weighing)):
            continue
        for geom in [geom for geom in weighing if geom.meshname in missing]:
            spec.delete(geom)
        left = [geom for geom in weighing if geom.meshname not in missing]
        if len(left) < len(weighing) and _moves(body):
            if left or body.explicitinertial:
                remarks.append(f"{body.name} weighs what the rest of it does: a mesh of it is missing")
            else:
                lost.append(body.name)
        if left:
            spec.adopt_inertial(body)
    if lost:
        raise ModelError(
            f"{path}: the mass of {', '.join(sorted(lost))} would come from a mesh that is missing",
            hint="put the mesh where the file looks for it, or give the body an <inertial>",
        )
    spec.compiler.inertiafromgeom = imported().mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    for geom in [geom for geom in spec.geoms if geom.meshname or geom.hfieldname]:
        spec.delete(geom)
    for asset in [*spec.meshes, *spec.hfields]:
        spec.delete(asset)
    return remarks


def _moves(body: Any) -> bool:
    """Tell whether a joint moves a body, its own or one further up."""
    while body is not None:
        if len(body.joints):
            return True
        body = body.parent
    return False


def _compile(spec: Any, path: Path) -> Any:
    try:
        return spec.compile()
    except ValueError as error:
        raise refusal(path, error, doing="build") from None


def _add_actuators(spec: Any, model: Any, drives: Mapping[str, Drive]) -> set[str]:
    """Give joints a torque, or a servo whose gains fit the inertia that each joint sees where the robot begins.

    What brakes a servo is put into its joint, where it is fitted: the motion shows no more than the sum. The inertia of
    a rotor of which the file says nothing is fitted as well; that of a servo from a matched gear's on. Return the names
    of the actuators: that of the joint, or another one where an actuator of that name drives something else.
    """
    taken, added = {actuator.name for actuator in spec.actuators}, set()
    mujoco = imported()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, full, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(model, data, full)
    for name, kind in drives.items():
        called = _free(name, taken, "servo" if kind == "position" else "motor")
        taken.add(called)
        added.add(called)
        actuator = spec.add_actuator(name=called, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        if kind == "torque":
            actuator.set_to_motor()
            continue
        joint, index = spec.joint(name), model.joint(name).dofadr[0]
        inertia = float(full[index, index])
        if not joint.armature:
            joint.armature = SERVO_ROTOR * inertia
            inertia += joint.armature
        omega = 2 * np.pi * SERVO_HZ
        actuator.set_to_position(kp=inertia * omega**2)
        joint.damping = [max(2 * SERVO_DAMPING * inertia * omega, joint.damping[0]), *joint.damping[1:]]
    return added


def _joints(mujoco: Any, joints: Collection[Any], model: Any) -> tuple[RobotJoint, ...]:
    outputs: list[str] = []
    made = []
    for joint in joints:
        number = model.joint(joint.name).id
        ends = tuple(float(end) for end in model.jnt_range[number]) if model.jnt_limited[number] else None
        unit = "rad" if joint.type == mujoco.mjtJoint.mjJNT_HINGE else "m"
        sprung = bool(np.any(model.jnt_stiffness[number]))
        # The rate of a joint is a state as well, of the joints before and of this joint.
        taken = {*outputs, *(f"{output}_rate" for output in outputs)}
        taken |= {output.removesuffix("_rate") for output in outputs if output.endswith("_rate")}
        output = _free(identifier(joint.name), taken)
        outputs.append(output)
        made.append(RobotJoint(joint.name, output, unit, ends, sprung))  # type: ignore[arg-type]
    return tuple(made)


def _actuators(
    mujoco: Any, spec: Any, joints: Collection[RobotJoint], added: Collection[str]
) -> tuple[RobotActuator, ...]:
    taken = {name for joint in joints for name in (joint.output, f"{joint.output}_rate")}
    made = []
    for actuator in spec.actuators:
        on_joint = actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT
        joint = next(
            (candidate for candidate in joints if on_joint and candidate.name == actuator.target), None
        )
        slides = joint is not None and joint.unit == "m"
        command = _command(mujoco, actuator)
        units: dict[Command, str] = {
            "position": "m" if slides else "rad", "velocity": "m/s" if slides else "rad/s",
            "torque": "1" if joint is None else "N" if slides else "N m", "geared": "1",
            "other": "1",
        }  # fmt: skip
        sole = (
            sum(
                other.target == actuator.target and other.trntype == actuator.trntype
                for other in spec.actuators
            )
            == 1
        )
        stem = joint.output if joint is not None and sole else identifier(actuator.name)
        if joint is None and any(stem == candidate.output for candidate in joints):
            stem += f"_{_transmission(mujoco, actuator)}"
        input_ = _free(f"{stem}_{_SUFFIX[command]}", taken)
        taken.add(input_)
        made.append(
            RobotActuator(
                actuator.name,
                input_,
                "" if joint is None else joint.name,
                command,
                units[command],
                actuator.name in added,
            )
        )
    return tuple(made)


def _transmission(mujoco: Any, actuator: Any) -> str:
    """Return through what an actuator acts that drives no joint alone: ``tendon``, ``site``, ``body``."""
    return str(mujoco.mjtTrn(actuator.trntype).name).removeprefix("mjTRN_").lower()


def _crossed(actuators: Collection[RobotActuator], joints: Collection[RobotJoint]) -> list[str]:
    """Return remarks on actuators named like a joint that they do not drive alone."""
    names = {joint.name for joint in joints}
    return [
        f"actuator {actuator.name} does not drive joint {actuator.name}, but "
        f"{f'joint {actuator.joint}' if actuator.joint else 'a tendon or site'}: its control is {actuator.input}"
        for actuator in actuators
        if actuator.name in names and actuator.joint != actuator.name
    ]


def _free(name: str, taken: Collection[str], suffix: str = "") -> str:
    """Return a name that is not taken: with a suffix, or with the next number."""
    if name not in taken:
        return name
    stem = f"{name}_{suffix}" if suffix else name
    if suffix and stem not in taken:
        return stem
    return next(f"{stem}_{number}" for number in count(2) if f"{stem}_{number}" not in taken)


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """Return names that equations can use, a different one for each name."""
    made: dict[str, str] = {}
    for name in names:
        made[name] = _free(identifier(name), made.values())
    return made


def _command(mujoco: Any, actuator: Any) -> Command:
    """Return the meaning of a control: position, velocity or torque (MuJoCo's documentation, Actuation)."""
    gain, bias = actuator.gainprm, actuator.biasprm
    if actuator.gaintype != mujoco.mjtGain.mjGAIN_FIXED or actuator.dyntype not in (
        mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT,
    ):  # fmt: skip
        return "other"
    if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
        return "torque" if gain[0] == 1.0 and actuator.gear[0] == 1.0 else "geared"
    if actuator.gear[0] != 1.0:
        return "other"
    if np.isclose(bias[1], -gain[0]) and gain[0] != 0.0:
        return "position"
    if bias[1] == 0.0 and np.isclose(bias[2], -gain[0]) and gain[0] != 0.0:
        return "velocity"
    return "other"


def identifier(name: str) -> str:
    """Return a name that equations can use."""
    made = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return made if made[:1].isalpha() else f"joint_{made}"
