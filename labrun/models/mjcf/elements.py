"""What a text such as ``"joint.hinge.damping"`` means in a compiled MJCF model."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from labrun.models.mjcf.plant import MemoryPlace, imported
from labrun.toml import suggest

SETTABLE = {
    "joint": {
        "stiffness": "jnt_stiffness",
        "damping": "dof_damping",
        "armature": "dof_armature",
        "frictionloss": "dof_frictionloss",
        "springref": "qpos_spring",
        "range": "jnt_range",
    },
    "body": {
        "mass": "body_mass",
        "inertia": "body_inertia",
        "ipos": "body_ipos",
        "pos": "body_pos",
        "gravcomp": "body_gravcomp",
    },
    "geom": {
        "friction": "geom_friction",
        "pos": "geom_pos",
        "margin": "geom_margin",
        "solref": "geom_solref",
        "solimp": "geom_solimp",
    },
    "actuator": {
        "gear": "actuator_gear",
        "gainprm": "actuator_gainprm",
        "biasprm": "actuator_biasprm",
        "dynprm": "actuator_dynprm",
        "forcerange": "actuator_forcerange",
        "ctrlrange": "actuator_ctrlrange",
    },
    "tendon": {
        "stiffness": "tendon_stiffness",
        "damping": "tendon_damping",
        "frictionloss": "tendon_frictionloss",
        "armature": "tendon_armature",
        "springlength": "tendon_lengthspring",
    },
    "equality": {"data": "eq_data", "solref": "eq_solref", "solimp": "eq_solimp"},
    "site": {"pos": "site_pos"},
}
"""What of an element can be set: its attribute in MJCF, and the array of the compiled model."""
OPTIONS = {"gravity": 3, "wind": 3, "density": 1, "viscosity": 1}
"""Numbers of ``mjOption``, and how many each is."""
FIRST_UNLESS_TOLD = ("friction", "gear")
"""Attributes of several numbers, of which people mean the first."""
SERVO = {"kp": ((("gainprm", 0, 1.0), ("biasprm", 1, -1.0))), "kv": ((("biasprm", 2, -1.0),))}
"""Gains of MJCF's position actuator."""
SHOWN = {
    "actuator": {"force": "actuator_force", "length": "actuator_length", "velocity": "actuator_velocity"},
    "tendon": {"length": "ten_length", "velocity": "ten_velocity"},
    "body": {"position": "xpos", "orientation": "xquat"},
    "site": {"position": "site_xpos"},
}
"""What of an element can be seen: how a table says it, and the array of the simulation's data."""
QUATERNION = ("qw", "qx", "qy", "qz")
SPIN = ("wx", "wy", "wz")
"""Parts of a ball joint's position and of its velocity; of a free joint's, behind those of the translation."""
_REFERENCE = re.compile(r"([a-z]+)\.(.+?)(?:\[(\d+)\])?\Z")


class ReferenceProblem(ValueError):  # noqa: N818 - becomes a ModelError where the file is known
    """A reference that means nothing; `hint` may be empty."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.hint = hint


class Elements:
    """The named elements of one compiled model; every method raises `ReferenceProblem`."""

    def __init__(self, model: Any) -> None:
        mujoco = imported()
        self.model = model
        objects = mujoco.mjtObj
        counts = {
            "joint": (objects.mjOBJ_JOINT, model.njnt),
            "body": (objects.mjOBJ_BODY, model.nbody),
            "geom": (objects.mjOBJ_GEOM, model.ngeom),
            "actuator": (objects.mjOBJ_ACTUATOR, model.nu),
            "tendon": (objects.mjOBJ_TENDON, model.ntendon),
            "equality": (objects.mjOBJ_EQUALITY, model.neq),
            "site": (objects.mjOBJ_SITE, model.nsite),
            "sensor": (objects.mjOBJ_SENSOR, model.nsensor),
        }
        self._names: dict[str, dict[str, int]] = {}
        for kind, (type_, count) in counts.items():
            named = {mujoco.mj_id2name(model, type_, index) or "": index for index in range(count)}
            self._names[kind] = {name: index for name, index in named.items() if name}
        self._names["mocap"] = {
            name: body for name, body in self._names["body"].items() if model.body_mocapid[body] >= 0
        }
        self._simple = {
            int(mujoco.mjtJoint.mjJNT_HINGE): (("position",), ("velocity",), ("acceleration",)),
            int(mujoco.mjtJoint.mjJNT_SLIDE): (("position",), ("velocity",), ("acceleration",)),
            int(mujoco.mjtJoint.mjJNT_BALL): (QUATERNION, SPIN, ()),
            int(mujoco.mjtJoint.mjJNT_FREE): (
                ("x", "y", "z", *QUATERNION),
                ("vx", "vy", "vz", *SPIN),
                (),
            ),
        }

    def joints(self) -> list[str]:
        """Return the name of every joint; those without are ``joint0``, ``joint1`` ... by their place."""
        names = {index: name for name, index in self._names["joint"].items()}
        return [names.get(index, f"joint{index}") for index in range(self.model.njnt)]

    def joint_quantities(self, joint: int) -> tuple[Sequence[str], Sequence[str], Sequence[str]]:
        """Return the names of a joint's positions, velocities and accelerations."""
        return self._simple[int(self.model.jnt_type[joint])]

    def activations(self) -> list[str]:
        """Return the name of the actuator of every activation state."""
        names = {index: name for name, index in self._names["actuator"].items()}
        owners = [
            actuator
            for actuator in range(self.model.nu)
            for _ in range(max(0, int(self.model.actuator_actnum[actuator])))
        ]
        return [names.get(actuator, f"actuator{actuator}") for actuator in owners]

    def one_joint(self, name: str) -> tuple[int, int]:
        """Return position and velocity index of a hinge or a slide."""
        joint = self._index("joint", name)
        if len(self.joint_quantities(joint)[0]) != 1:
            raise ReferenceProblem(f"joint {name!r} is a ball or free joint: it has no single coordinate")
        return int(self.model.jnt_qposadr[joint]), int(self.model.jnt_dofadr[joint])

    def settable(self, text: str) -> tuple[MemoryPlace, ...]:
        """Return the numbers that an attribute of an element is in the compiled model."""
        kind, rest, index = _parts(text, (*SETTABLE, "option"))
        if kind == "option":
            return (self._option(rest, index),)
        name, attribute = _named(kind, rest, index)
        element = self._index(kind, name)
        if kind == "actuator" and attribute in SERVO:
            return self._servo(element, name, attribute)
        arrays = SETTABLE[kind]
        if attribute not in arrays:
            known = [*arrays, *(SERVO if kind == "actuator" else ())]
            raise ReferenceProblem(f"a {kind} has no {attribute!r} to set", suggest(attribute, known))
        array = np.asarray(getattr(self.model, arrays[attribute]))
        width = array.shape[1] if array.ndim == 2 else 1
        column = _component(f"{kind}.{name}.{attribute}", width, index, attribute in FIRST_UNLESS_TOLD)
        if attribute == "ipos":
            self._refuse_balanced(element, name)
        rows = self._rows(kind, element, arrays[attribute])
        return tuple(MemoryPlace("model", arrays[attribute], row * width + column) for row in rows)

    def driven(self, text: str) -> MemoryPlace:
        """Return the number that an input is: a control, a generalized force, a force on a body, a position."""
        kind, rest, index = _parts(text, ("actuator", "joint", "body", "mocap"))
        if kind == "actuator":
            return MemoryPlace("data", "ctrl", self._index(kind, rest))
        if kind == "joint":
            return MemoryPlace("data", "qfrc_applied", self.one_joint(rest)[1])
        name, attribute = _named(kind, rest, index)
        element = self._index(kind, name)
        if kind == "mocap":
            axes = ("x", "y", "z")
            if attribute not in axes:
                raise ReferenceProblem(f"a mocap body has no {attribute!r} to drive", "x, y or z")
            return MemoryPlace(
                "data", "mocap_pos", 3 * int(self.model.body_mocapid[element]) + axes.index(attribute)
            )
        if attribute not in ("force", "torque"):
            raise ReferenceProblem(f"a body has no {attribute!r} to drive", "force[0], torque[2] ...")
        column = _component(text, 3, index, first=False) + (3 if attribute == "torque" else 0)
        return MemoryPlace("data", "xfrc_applied", 6 * element + column)

    def shown(self, text: str) -> MemoryPlace:
        """Return the number that an output is."""
        kind, rest, index = _parts(text, ("joint", "sensor", "actuator", "tendon", "body", "site"))
        if kind == "sensor":
            sensor = self._index(kind, rest)
            width = int(self.model.sensor_dim[sensor])
            column = _component(f"sensor.{rest}", width, index, first=False)
            return MemoryPlace("data", "sensordata", int(self.model.sensor_adr[sensor]) + column)
        name, attribute = _named(kind, rest, index)
        if kind == "joint":
            return self.moving(name, attribute)
        element, arrays = self._index(kind, name), SHOWN[kind]
        if attribute not in arrays:
            raise ReferenceProblem(f"a {kind} shows no {attribute!r}", suggest(attribute, list(arrays)))
        width = {"position": 3, "orientation": 4}.get(attribute, 1)
        column = _component(text, width, index, first=False)
        return MemoryPlace("data", arrays[attribute], element * width + column)

    def moving(self, name: str, quantity: str) -> MemoryPlace:
        """Return a position, velocity or acceleration of a joint."""
        joint = self._index("joint", name)
        positions, velocities, accelerations = self.joint_quantities(joint)
        if quantity in positions:
            return MemoryPlace(
                "data", "qpos", int(self.model.jnt_qposadr[joint]) + list(positions).index(quantity)
            )
        dof = int(self.model.jnt_dofadr[joint])
        if quantity in velocities:
            return MemoryPlace("data", "qvel", dof + list(velocities).index(quantity))
        if quantity in accelerations:
            return MemoryPlace("data", "qacc", dof)
        known = [*positions, *velocities, *accelerations]
        raise ReferenceProblem(f"joint {name!r} has no {quantity!r}", suggest(quantity, known))

    def _index(self, kind: str, name: str) -> int:
        names = self._names[kind]
        if name in names:
            return names[name]
        what = "mocap body" if kind == "mocap" else kind
        hint = suggest(name, list(names)) if names else f"no {what} of it has a name"
        raise ReferenceProblem(f"the MJCF model has no {what} {name!r}", hint)

    def _rows(self, kind: str, element: int, array: str) -> range:
        """Return the rows of an element: of a ball or free joint, one for each degree of freedom."""
        if kind != "joint" or array.startswith("jnt_"):
            return range(element, element + 1)
        positions, velocities, _ = self.joint_quantities(element)
        if array.startswith("qpos_"):
            first = int(self.model.jnt_qposadr[element])
            if len(positions) != 1:
                raise ReferenceProblem("springref is for hinge and slide joints")
            return range(first, first + 1)
        first = int(self.model.jnt_dofadr[element])
        return range(first, first + len(velocities))

    def _servo(self, actuator: int, name: str, gain: str) -> tuple[MemoryPlace, ...]:
        bias = self.model.actuator_biasprm[actuator]
        if self.model.actuator_biastype[actuator] == 0 or bias[1] == 0.0:
            raise ReferenceProblem(
                f"actuator {name!r} is not a position servo, which alone has {gain}",
                f"set actuator.{name}.gainprm[0] or actuator.{name}.biasprm[2]",
            )
        width = self.model.actuator_gainprm.shape[1]
        return tuple(
            MemoryPlace("model", f"actuator_{array}", actuator * width + column, factor)
            for array, column, factor in SERVO[gain]
        )

    def _option(self, name: str, index: int | None) -> MemoryPlace:
        if name not in OPTIONS:
            raise ReferenceProblem(f"unknown option {name!r} to set", suggest(name, list(OPTIONS)))
        return MemoryPlace("option", name, _component(f"option.{name}", OPTIONS[name], index, first=False))

    def _refuse_balanced(self, body: int, name: str) -> None:
        # MuJoCo stores no coupling terms for a body that turns about its centre of mass, and cannot be given any later
        if self.model.body_simple[body]:
            raise ReferenceProblem(
                f"body {name!r} turns about its own centre of mass, and its compiled form keeps it there",
                "move its centre a little off the joint in the MJCF file",
            )


def _parts(text: str, kinds: Sequence[str]) -> tuple[str, str, int | None]:
    match = _REFERENCE.match(text)
    if match is None or match[1] not in kinds:
        kind = text.partition(".")[0]
        example = suggest(kind, list(kinds)) if kind not in kinds else "write it as joint.hinge.damping"
        raise ReferenceProblem(f"{text!r} names no part of the MJCF file that fits here", example)
    return match[1], match[2], None if match[3] is None else int(match[3])


def _named(kind: str, rest: str, index: int | None) -> tuple[str, str]:
    """Split into name and attribute; a name may have dots."""
    name, _, attribute = rest.rpartition(".")
    if not name:
        message = f"{kind}.{rest}" if index is None else f"{kind}.{rest}[{index}]"
        raise ReferenceProblem(
            f"{message!r} names an element but no quantity", f"write {kind}.{rest}.something"
        )
    return name, attribute


def _component(message: str, width: int, index: int | None, first: bool) -> int:
    if index is None:
        if width == 1 or first:
            return 0
        raise ReferenceProblem(
            f"{message} has {width} numbers", f"say which: {message}[0] to {message}[{width - 1}]"
        )
    if index >= width:
        raise ReferenceProblem(
            f"{message} has {width} numbers, so [{index}] is out of range", "[0] is the first"
        )
    return index
