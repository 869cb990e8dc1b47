"""Model files with a ``mujoco`` key: what of the MJCF file is a state, a parameter, an input, an output, a site."""

import dataclasses
import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from labrun.effects import Site
from labrun.models.attaching import read_effects
from labrun.models.fields import Fields, Key
from labrun.models.mjcf.elements import Elements, ReferenceProblem
from labrun.models.mjcf.model import MujocoModel, functions
from labrun.models.mjcf.plant import Layout, Place, imported, pack
from labrun.models.model import Input, Output, Parameter
from labrun.models.toml_model import (
    conditions_of,
    only_in_loads,
    places_of,
    read_initial,
    read_inputs,
    read_outputs,
    read_parameters,
    read_site_quantities,
    refuse_unused,
)
from labrun.toml import Expression, ExpressionError, KeyPath, suggest

KEYS = (
    "name", "title", "mujoco", "states", "inputs", "conditions", "parameters", "mjcf", "outputs", "sites", "initial",
    "effects",
)  # fmt: skip
_SITE_KEYS = ("kind", "joint", "stiffness", "load")
Found = TypeVar("Found")


@dataclass(frozen=True)
class States:
    """All positions, then all velocities, then all activations.

    Attributes
    ----------
    names, places
    rates
        Where each derivative is found; None for parts of quaternions.
    quaternions : (first state, its angular velocity)
    reference
        Where the MJCF file begins.
    """

    names: tuple[str, ...]
    places: tuple[Place, ...]
    rates: tuple[Place | None, ...]
    quaternions: tuple[tuple[int, Place], ...]
    reference: tuple[float, ...]

    def named(self, place: Place) -> str:
        """Return the name of the state at a place."""
        return self.names[self.places.index(place)]


def mujoco_model(fields: Fields) -> MujocoModel:
    """Return the model of a file with a ``mujoco`` key.

    Raises
    ------
    ModelError
        MuJoCo is not installed, the MJCF file does not compile, or a line of the table does not fit it.
    """
    for key in fields.data:
        if key not in KEYS:
            raise fields.text.unknown_key("", key, KEYS)
    name = fields.data.get("name")
    if not isinstance(name, str) or not name:
        raise fields.text.error("name", 'a model needs a name = "..."')
    native = _compiled(fields)
    elements = Elements(native)
    states = _states(fields, elements)
    inputs, driven = _inputs(fields, elements)
    outputs, shown = _outputs(fields, elements)
    parameters, settings = _parameters(fields, elements)
    sites, joints = _sites(fields, elements, states, parameters)
    places = places_of(fields, states.names, inputs, parameters)

    quantities = read_site_quantities(fields, sites)
    expressions: dict[KeyPath, Expression] = {path: one for path, (one, _) in settings.items()}
    expressions |= {tuple(key.split(".")): one for key, one in quantities.items()}
    declared = fields.names("conditions") if "conditions" in fields.data else None
    conditions = conditions_of(fields, expressions, places, declared)
    refuse_unused(fields, expressions, parameters, conditions)
    places |= {one: f"p[{len(parameters) + index}]" for index, one in enumerate(conditions)}
    _check_settings(fields, settings, places)

    at = len(parameters) + len(conditions)
    made = functions(
        [one for one, _ in settings.values()],
        list(quantities.values()),
        places,
        at,
    )
    layout = Layout(
        binary=pack(native),
        key="",
        at=at,
        states=states.places,
        rates=states.rates,
        quaternions=states.quaternions,
        inputs=driven,
        sites=joints,
        values=len(settings),
        settings=tuple(
            (index, place) for index, (_, targets) in enumerate(settings.values()) for place in targets
        ),
        outputs=shown,
    )
    model = MujocoModel(
        name=name,
        states=states.names,
        inputs=inputs,
        outputs=outputs,
        parameters=parameters,
        conditions=conditions,
        sites=sites,
        initial=_initial(fields, states, outputs),
        derivative=made["derivative"],
        output=made["output"],
        site_values=made["site_values"],
        source=fields.text.name,
        notes=(*_notes(native), *only_in_loads(expressions, parameters)),
        layout=dataclasses.replace(layout, key=hashlib.sha256(repr(layout).encode()).hexdigest()),
    )
    return dataclasses.replace(model, effects=read_effects(fields, model))


def _compiled(fields: Fields) -> Any:
    path = Path(fields.text.name).parent / fields.string("mujoco", fields.data["mujoco"])
    mujoco = imported()
    if not path.is_file():
        raise fields.text.error(
            "mujoco", f"there is no MJCF file {path}", "its path is counted from this file"
        )
    try:
        native = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise fields.text.error("mujoco", f"MuJoCo cannot read {path}: {error}") from None
    if getattr(native, "nhistory", 0):
        raise fields.text.error(
            "mujoco",
            f"{path.name} has actuators or sensors with a delay, which labrun does not simulate inside MuJoCo",
            'take it out, and put an effect "delay" at the input or the output',
        )
    data = mujoco.MjData(native)
    mujoco.mj_forward(native, data)
    if not np.isfinite(data.qacc).all():
        raise fields.text.error(
            "mujoco", f"{path.name} has accelerations that are not finite where it begins"
        )
    return native


def _resolve(fields: Fields, key: Key, ask: Callable[[str], Found], text: Any) -> Found:
    try:
        return ask(fields.string(key, text))
    except ReferenceProblem as problem:
        raise fields.text.error(key, str(problem), problem.hint) from None


def _without(fields: Fields, table: str, entries: Mapping[str, Any]) -> Fields:
    """Return the fields with a table from which the references to the MJCF file are taken out."""
    return Fields(fields.text, {**fields.data, table: entries})


def _inputs(fields: Fields, elements: Elements) -> tuple[tuple[Input, ...], tuple[Place, ...]]:
    plain, driven = {}, []
    for name, given in fields.table("inputs").items():
        entry = {"mjcf": given} if isinstance(given, str) else given
        fields.check_keys(f"inputs.{name}", entry, ("mjcf", "unit", "between"))
        if "mjcf" not in entry:
            raise fields.text.error(f"inputs.{name}", "it drives nothing", 'mjcf = "actuator.motor"')
        key = f"inputs.{name}.mjcf" if isinstance(given, dict) else f"inputs.{name}"
        driven.append(_resolve(fields, key, elements.driven, entry["mjcf"]))
        plain[name] = {one: value for one, value in entry.items() if one != "mjcf"}
    return read_inputs(_without(fields, "inputs", plain)), tuple(driven)


def _outputs(fields: Fields, elements: Elements) -> tuple[tuple[Output, ...], tuple[Place, ...]]:
    plain, shown = {}, []
    for name, given in fields.table("outputs").items():
        entry = {"mjcf": given} if isinstance(given, str) else given
        fields.check_keys(f"outputs.{name}", entry, ("mjcf", "unit"))
        if "mjcf" not in entry:
            raise fields.text.error(f"outputs.{name}", "it shows nothing", 'mjcf = "joint.hinge.position"')
        key = f"outputs.{name}.mjcf" if isinstance(given, dict) else f"outputs.{name}"
        shown.append(_resolve(fields, key, elements.shown, entry["mjcf"]))
        plain[name] = {"equation": 0.0, **{one: value for one, value in entry.items() if one != "mjcf"}}
    return read_outputs(_without(fields, "outputs", plain))[0], tuple(shown)


Settings = dict[KeyPath, tuple[Expression, tuple[Place, ...]]]
"""By the key that declares it: the value, and where it is written."""


def _parameters(fields: Fields, elements: Elements) -> tuple[tuple[Parameter, ...], Settings]:
    """Read the parameters, and all that sets something in the MJCF model."""
    plain: dict[str, Any] = {}
    settings: Settings = {}
    for name, given in fields.table("parameters").items():
        plain[name] = given
        if not isinstance(given, dict) or "mjcf" not in given:
            continue
        path: KeyPath = ("parameters", name, "mjcf")
        fields.check_name(path, name)
        targets = _resolve(fields, path, elements.settable, given["mjcf"])
        settings[path] = fields.expression(path, name), targets
        plain[name] = {"value": targets[0].read(elements.model), **given}
        del plain[name]["mjcf"]
    for reference, equation in fields.table("mjcf").items():
        path = ("mjcf", reference)
        targets = _resolve(fields, path, elements.settable, reference)
        settings[path] = fields.expression(path, equation), targets
    taken: dict[Place, KeyPath] = {}
    for path, (_, targets) in settings.items():
        for place in targets:
            if place in taken:
                other = fields.text.line_of(taken[place])
                raise fields.text.error(path, f"line {other} sets the same number of the MJCF model")
            taken[place] = path
    return read_parameters(_without(fields, "parameters", plain)), settings


def _check_settings(fields: Fields, settings: Settings, places: Mapping[str, str]) -> None:
    for path, (expression, _) in settings.items():
        for name, position in expression.names.items():
            if not places.get(name, "").startswith("p["):
                what = "a site's force" if name.startswith("force.") else f"{name!r}, which moves"
                problem = ExpressionError(
                    expression.text,
                    f"the MJCF model cannot depend on {what}",
                    position,
                    "use parameters and conditions",
                )
                raise fields.text.equation_error(path, problem)


def _sites(
    fields: Fields, elements: Elements, states: States, parameters: tuple[Parameter, ...]
) -> tuple[tuple[Site, ...], tuple[Place, ...]]:
    sites, forces = [], []
    for name, entry in fields.table("sites").items():
        key = f"sites.{name}"
        fields.check_name(key, name)
        fields.check_keys(key, entry, _SITE_KEYS)
        kind = entry.get("kind", "joint")
        if kind not in ("joint", "body"):
            raise fields.text.error(f"{key}.kind", f"a site is a joint or a body, not {kind!r}")
        position, dof = _resolve(fields, f"{key}.joint", elements.one_joint, entry.get("joint", name))
        stiffness = fields.string(f"{key}.stiffness", entry.get("stiffness", ""))
        known = [one.name for one in parameters]
        if stiffness and stiffness not in known:
            raise fields.text.error(
                f"{key}.stiffness", f"there is no parameter {stiffness!r}", suggest(stiffness, known)
            )
        coordinate, rate = (
            states.named(Place("data", "qpos", position)),
            states.named(Place("data", "qvel", dof)),
        )
        load = fields.string(f"{key}.load", entry.get("load", ""))
        sites.append(Site(name, kind, coordinate, rate, load, stiffness))
        forces.append(Place("data", "qfrc_applied", dof))
    return tuple(sites), tuple(forces)


def _initial(fields: Fields, states: States, outputs: tuple[Output, ...]) -> dict[str, float | str]:
    """Read where each state starts; where the file does not say, it is where the MJCF file begins."""
    rules = read_initial(fields, states.names, outputs)
    table = fields.table("initial")
    own = dict(zip(states.names, states.reference, strict=True))
    return {state: rule if state in table else own[state] for state, rule in rules.items()}


def _notes(native: Any) -> tuple[str, ...]:
    notes = []
    if np.any(native.sensor_noise):
        notes.append("MuJoCo's sensor noise is left out: a model's outputs are without noise")
    if native.nplugin:
        notes.append("plugins of MuJoCo with states of their own are not advanced")
    return tuple(notes)


def _states(fields: Fields, elements: Elements) -> States:
    """Return the states; the file's table ``[states]`` names those it wants to name.

    A position is otherwise called ``<joint>_position``, a velocity ``<joint>_velocity``, an activation
    ``<actuator>_activation``; those of ball and free joints ``<joint>_qw``, ``<joint>_wx``, ``<joint>_x`` and so on.

    Raises
    ------
    ModelError
        A name for something that is no state, or a name that stands for two.
    """
    model = elements.model
    names: list[str] = []
    places: list[Place] = []
    rates: list[Place | None] = []
    quaternions: list[tuple[int, Place]] = []
    joints = elements.joints()
    for joint, label in enumerate(joints):
        positions, _, _ = elements.joint_quantities(joint)
        first, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        for index, quantity in enumerate(positions):
            turning = quantity.startswith("q")
            if quantity == "qw":
                quaternions.append((len(names), Place("data", "qvel", dof + index)))
            names.append(_name(label, quantity))
            places.append(Place("data", "qpos", first + index))
            rates.append(None if turning else Place("data", "qvel", dof + index))
    for joint, label in enumerate(joints):
        for index, quantity in enumerate(elements.joint_quantities(joint)[1]):
            dof = int(model.jnt_dofadr[joint]) + index
            names.append(_name(label, quantity))
            places.append(Place("data", "qvel", dof))
            rates.append(Place("data", "qacc", dof))
    for index, label in enumerate(elements.activations()):
        names.append(_name(label, "activation"))
        places.append(Place("data", "act", index))
        rates.append(Place("data", "act_dot", index))
    _rename(fields, elements, names, places)
    reference = (*(float(one) for one in model.qpos0), *[0.0] * (model.nv + model.na))
    return States(tuple(names), tuple(places), tuple(rates), tuple(quaternions), reference)


def _rename(fields: Fields, elements: Elements, names: list[str], places: list[Place]) -> None:
    for name, text in fields.table("states").items():
        key = f"states.{name}"
        fields.check_name(key, name)
        joint, _, quantity = fields.string(key, text).removeprefix("joint.").rpartition(".")
        try:
            place = elements.moving(joint, quantity)
        except ReferenceProblem as problem:
            raise fields.text.error(key, str(problem), problem.hint) from None
        if place not in places:
            raise fields.text.error(key, f"{text!r} is no state", "a joint's position or velocity is one")
        names[places.index(place)] = name
    for name in names:
        if names.count(name) > 1:
            raise fields.text.error(
                "states", f"two states are called {name!r}", "give one another name in [states]"
            )


def _name(label: str, quantity: str) -> str:
    """Return a name that equations can use."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", f"{label}_{quantity}")
    return name if name[:1].isalpha() else f"joint_{name}"
