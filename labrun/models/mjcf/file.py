"""Model files with a ``mujoco`` key: what of the MJCF file is a state, a parameter, an input, an output, a site."""

import dataclasses
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from labrun.effects import Site
from labrun.errors import ModelError
from labrun.models.mjcf.elements import Elements, ReferenceProblem
from labrun.models.mjcf.model import AT_REST, MujocoModel, functions
from labrun.models.mjcf.plant import MemoryPlace, MjcfLayout, has_loops, imported, pack
from labrun.models.mjcf.robot import identifier, robot_spec
from labrun.models.model import Output, Parameter
from labrun.models.reading import (
    SITE_QUANTITIES,
    conditions_of,
    initial_of,
    inputs_of,
    meanings_of,
    only_in_loads,
    parameter_of,
    places_of,
    read_effects,
    refuse_unused,
)
from labrun.models.tables import ModelFile, MujocoFile
from labrun.toml import Expression, ExpressionError, KeyPath, suggest

Found = TypeVar("Found")
_TIGHT_LOOPS = 3, 7
"""The first MuJoCo whose `connect` and `weld` hold accelerations with the derivative of their Jacobian."""


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
    places: tuple[MemoryPlace, ...]
    rates: tuple[MemoryPlace | None, ...]
    quaternions: tuple[tuple[int, MemoryPlace], ...]
    reference: tuple[float, ...]

    def location(self, name: str) -> MemoryPlace:
        """Return where a state is."""
        return self.places[self.names.index(name)]

    def named(self, memory: MemoryPlace) -> str:
        """Return the name of the state at a place."""
        return self.names[self.places.index(memory)]


def mujoco_model(file: ModelFile) -> MujocoModel:
    """Return the model of a file with a ``mujoco`` key.

    Raises ModelError: MuJoCo is not installed, the MJCF file does not compile, or lines of the table do not fit it.
    """
    given = file.read(MujocoFile)
    native = _compiled(file, given.mujoco)
    elements = Elements(native)
    states = _states(file, elements, given.states)
    inputs = inputs_of(given.inputs)
    outputs = tuple(Output(name, output.unit) for name, output in given.outputs.items())
    driven = _resolved(
        file, "inputs", {name: signal.mjcf for name, signal in given.inputs.items()}, elements.driven
    )
    shown = _resolved(
        file, "outputs", {name: output.mjcf for name, output in given.outputs.items()}, elements.shown
    )
    joints = {name: site.joint or name for name, site in given.sites.items()}
    dofs = _resolved(file, "sites", joints, elements.one_joint, "joint")
    settings = _settings(file, given, elements)
    file.refuse()
    parameters = _parameters(file, given, settings, native)
    sites = tuple(
        Site(
            name,
            site.kind,
            states.named(MemoryPlace("data", "qpos", position)),
            states.named(MemoryPlace("data", "qvel", dof)),
            site.load.text if "load" in site.model_fields_set else "",
            site.stiffness.text if site.stiffness.names else "",
            site.drive,
        )
        for (name, site), (position, dof) in zip(given.sites.items(), dofs, strict=True)
    )
    places = places_of(file, states.names, inputs, parameters)
    quantities: dict[KeyPath, Expression] = {
        ("sites", site.name, quantity): Expression.of(getattr(site, quantity) or 0.0)
        for site in sites
        for quantity in SITE_QUANTITIES
    }
    expressions = {path: expression for path, (expression, _) in settings.items()} | quantities
    _check_springs(file, given)
    conditions = conditions_of(file, expressions, places, given.conditions)
    initial = _initial(file, given, states, outputs)
    guesses = _guesses(native, states)
    file.refuse()
    refuse_unused(file, expressions, parameters, conditions)
    places |= {condition: f"p[{len(parameters) + index}]" for index, condition in enumerate(conditions)}
    _check_settings(file, settings, places)
    file.refuse()

    at = len(parameters) + len(conditions)
    made = functions(
        [expression for expression, _ in settings.values()],
        list(quantities.values()),
        places,
        at,
    )
    layout = MjcfLayout(
        binary=pack(native),
        key="",
        at=at,
        states=states.places,
        rates=states.rates,
        quaternions=states.quaternions,
        inputs=driven,
        sites=tuple(MemoryPlace("data", "qfrc_applied", dof) for _, dof in dofs),
        values=len(settings),
        settings=tuple(
            (index, target) for index, (_, targets) in enumerate(settings.values()) for target in targets
        ),
        outputs=shown,
    )
    model = MujocoModel(
        name=given.name,
        states=states.names,
        inputs=inputs,
        outputs=outputs,
        parameters=parameters,
        conditions=conditions,
        meanings=meanings_of(given.conditions),
        sites=sites,
        initial=initial,
        derivative=made["derivative"],
        output=made["output"],
        site_values=made["site_values"],
        source=file.name,
        notes=(*_notes(native), *only_in_loads(expressions, parameters)),
        layout=dataclasses.replace(layout, key=hashlib.sha256(repr(layout).encode()).hexdigest()),
        mjcf=given.mujoco
        if given.mujoco.lstrip().startswith("<")
        else str(Path(file.name).parent / given.mujoco),
        closes=has_loops(native),
        guesses=guesses,
    ).with_initial(given.initial)
    return dataclasses.replace(model, effects=read_effects(file, given.effects, model))


def _compiled(file: ModelFile, name: str) -> Any:
    inline = name.lstrip().startswith("<")
    path = Path(file.name) if inline else Path(file.name).parent / name
    mujoco = imported()
    if not path.is_file() and not inline:
        file.fail(("mujoco",), f"cannot find the MJCF file {path}", "its path is counted from this file")
    try:
        native = mujoco.MjModel.from_xml_string(name) if inline else _from_path(path)
    except ModelError as error:
        file.fail(("mujoco",), str(error.args[0]), error.hint or "")
    except ValueError as error:
        file.fail(("mujoco",), f"MuJoCo cannot read {path}: {error}")
    if getattr(native, "nhistory", 0):
        file.fail(
            ("mujoco",),
            f"{path.name} has actuators or sensors with a delay, which labrun does not simulate inside MuJoCo",
            'take it out, and put an effect "delay" at the input or the output',
        )
    data = mujoco.MjData(native)
    mujoco.mj_forward(native, data)
    if not np.isfinite(data.qacc).all():
        file.fail(("mujoco",), f"{path.name} has accelerations that are not finite where it begins")
    return native


def _from_path(path: Path) -> Any:
    """Compile a file; if MuJoCo refuses it, again without its missing meshes."""
    mujoco = imported()
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as refused:
        try:
            spec, left_out = robot_spec(path)
        except ModelError:
            left_out = []
        if not left_out:
            raise refused
        return spec.compile()


def _resolve(file: ModelFile, path: KeyPath, ask: Callable[[str], Found], text: str) -> Found | None:
    """Resolve a reference to the MJCF file; return None and note a fault if it is invalid."""
    try:
        return ask(text)
    except ReferenceProblem as problem:
        file.note(path, str(problem), problem.hint)
        return None


def _resolved(
    file: ModelFile, table: str, texts: Mapping[str, str], ask: Callable[[str], Found], key: str = "mjcf"
) -> tuple[Found, ...]:
    """Return what each reference of a table means; those that mean nothing are left out, and are faults."""
    founds = [_resolve(file, (table, name, key), ask, text) for name, text in texts.items()]
    return tuple(match for match in founds if match is not None)


Settings = dict[KeyPath, tuple[Expression, tuple[MemoryPlace, ...]]]
"""By the key that declares it: the value, and where it is written."""


def _settings(file: ModelFile, given: MujocoFile, elements: Elements) -> Settings:
    """Return all that sets something in the MJCF model."""
    asked: dict[KeyPath, tuple[str, Expression]] = {
        ("parameters", name, "mjcf"): (parameter.mjcf, Expression.of(name))
        for name, parameter in given.parameters.items()
        if parameter.mjcf
    }
    asked |= {("mjcf", reference): (reference, equation) for reference, equation in given.mjcf.items()}
    settings: Settings = {}
    taken: dict[MemoryPlace, KeyPath] = {}
    for path, (reference, expression) in asked.items():
        targets = _resolve(file, path, elements.settable, reference)
        if targets is None:
            continue
        settings[path] = expression, targets
        for target in targets:
            if target in taken:
                file.note(path, f"line {file.line_of(taken[target])} sets the same number of the MJCF model")
            taken[target] = path
    return settings


def _parameters(file: ModelFile, given: MujocoFile, settings: Settings, native: Any) -> tuple[Parameter, ...]:
    parameters = []
    for name, parameter in given.parameters.items():
        value, path = parameter.value, ("parameters", name, "mjcf")
        if value is None and path in settings:
            value = float(settings[path][1][0].read(native))
            if not parameter.lower <= value <= parameter.upper:
                file.note(
                    path,
                    f"the value {value:g} is outside of its bounds {parameter.lower:g} to {parameter.upper:g}",
                )
        if value is None:
            file.note(("parameters", name), 'the key "value" is missing')
        parameters.append(parameter_of(name, parameter, value or 0.0))
    return tuple(parameters)


def _check_settings(file: ModelFile, settings: Settings, places: Mapping[str, str]) -> None:
    for path, (expression, _) in settings.items():
        for name, position in expression.names.items():
            if not places.get(name, "").startswith("p["):
                what = "a site's force" if name.startswith("force.") else f"{name!r}, which moves"
                reason = f"the MJCF model cannot depend on {what}"
                hint = "use parameters and conditions"
                file.note_in(path, ExpressionError(expression.text, reason, position, hint))


def _check_springs(file: ModelFile, given: MujocoFile) -> None:
    for site, table in given.sites.items():
        for name in table.stiffness.names:
            if name not in given.parameters:
                hint = suggest(name, given.parameters)
                file.note(("sites", site, "stiffness"), f"unknown parameter {name!r}", hint)


def _initial(
    file: ModelFile, given: MujocoFile, states: States, outputs: tuple[Output, ...]
) -> dict[str, float | str]:
    """Return where each state starts; where the file does not say, it is where the MJCF file begins."""
    for state, rule in given.initial.items():
        if rule == AT_REST and state in states.names and states.location(state).array != "qpos":
            file.note(("initial", state), f'"{AT_REST}" is for positions', "rates begin at 0")
    rules = {
        state: rule for state, rule in given.initial.items() if rule != AT_REST or state not in states.names
    }
    initial_of(file, rules, states.names, outputs)
    return dict(zip(states.names, states.reference, strict=True))


def _guesses(native: Any, states: States) -> dict[str, float]:
    """Return where the search for rest begins: at the first keyframe, else where the MJCF file begins."""
    positions = native.key_qpos[0] if native.nkey else native.qpos0
    return {
        name: float(positions[location.index])
        for name, location in zip(states.names, states.places, strict=True)
        if location.array == "qpos"
    }


def _notes(native: Any) -> tuple[str, ...]:
    notes = []
    if np.any(native.sensor_noise):
        notes.append("MuJoCo's sensor noise is left out: a model's outputs are without noise")
    if native.nplugin:
        notes.append("plugins of MuJoCo with states of their own are not advanced")
    version = imported().mj_versionString()
    if has_loops(native) and tuple(map(int, version.split(".")[:2])) < _TIGHT_LOOPS:
        notes.append(
            f"MuJoCo {version} neglects that the directions of constraints turn: moving loops open by some 1e-3 rad; "
            "update it to 3.7"
        )
    return tuple(notes)


def _states(file: ModelFile, elements: Elements, renamed: Mapping[str, str]) -> States:
    """Return the states; the file's table ``[states]`` names those it wants to name.

    A position is otherwise called ``<joint>_position``, a velocity ``<joint>_velocity``, an activation
    ``<actuator>_activation``; those of ball and free joints ``<joint>_qw``, ``<joint>_wx``, ``<joint>_x`` and so on.

    A name for something that is no state, or one that stands for two, is a fault.
    """
    model = elements.model
    names: list[str] = []
    places: list[MemoryPlace] = []
    rates: list[MemoryPlace | None] = []
    quaternions: list[tuple[int, MemoryPlace]] = []
    joints = elements.joints()
    for joint, label in enumerate(joints):
        positions, _, _ = elements.joint_quantities(joint)
        first, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        for index, quantity in enumerate(positions):
            turning = quantity.startswith("q")
            if quantity == "qw":
                quaternions.append((len(names), MemoryPlace("data", "qvel", dof + index)))
            names.append(identifier(f"{label}_{quantity}"))
            places.append(MemoryPlace("data", "qpos", first + index))
            rates.append(None if turning else MemoryPlace("data", "qvel", dof + index))
    for joint, label in enumerate(joints):
        for index, quantity in enumerate(elements.joint_quantities(joint)[1]):
            dof = int(model.jnt_dofadr[joint]) + index
            names.append(identifier(f"{label}_{quantity}"))
            places.append(MemoryPlace("data", "qvel", dof))
            rates.append(MemoryPlace("data", "qacc", dof))
    for index, label in enumerate(elements.activations()):
        names.append(identifier(f"{label}_activation"))
        places.append(MemoryPlace("data", "act", index))
        rates.append(MemoryPlace("data", "act_dot", index))
    _rename(file, elements, renamed, names, places)
    reference = (*(float(position) for position in model.qpos0), *[0.0] * (model.nv + model.na))
    return States(tuple(names), tuple(places), tuple(rates), tuple(quaternions), reference)


def _rename(
    file: ModelFile,
    elements: Elements,
    renamed: Mapping[str, str],
    names: list[str],
    places: list[MemoryPlace],
) -> None:
    for name, text in renamed.items():
        joint, _, quantity = text.removeprefix("joint.").rpartition(".")
        memory = _resolve(file, ("states", name), partial(elements.moving, joint), quantity)
        if memory is not None and memory not in places:
            file.note(("states", name), f"{text!r} is not a state", "use a joint's position or velocity")
        elif memory is not None:
            names[places.index(memory)] = name
    twice = {name for name in names if names.count(name) > 1}
    for name in sorted(twice):
        file.note(("states",), f"two states are called {name!r}", "give one another name in [states]")
