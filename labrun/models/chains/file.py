"""Model files with ``[bodies]``, ``[joints]`` and ``[loop]``: what hangs on what, and which numbers it takes."""

# ruff: noqa: RUF012 - pydantic copies defaults

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field

from labrun.arrays import FloatArray
from labrun.effects import Site
from labrun.models.chains.model import AT_REST, ClosedChain
from labrun.models.chains.tree import CLOSED, MEASURES, OPENINGS, Tree, functions
from labrun.models.model import Output
from labrun.models.reading import (
    Expressions,
    conditions_of,
    initial_of,
    inputs_of,
    meanings_of,
    parameter_of,
    places_of,
    read_effects,
    refuse_unused,
)
from labrun.models.tables import (
    Equation,
    Finite,
    InputTable,
    ModelFile,
    Name,
    OutputTable,
    ParameterTable,
    SystemFile,
    alone,
    listed,
)
from labrun.toml import Expression, ExpressionError, KeyPath, Table, suggest

Vector = tuple[Equation, Equation, Equation]
_ROUNDING = 1e-6
"""Share of the largest principal moment of inertia by which rounded numbers may leave another below 0."""
_NOTHING = (Expression.of(0.0),) * 3


class BodyTable(Table):
    """A rigid body, as it lies when all angles are 0.

    Attributes
    ----------
    fixed
        Whether it is the one that does not move.
    mass_kg
        Its mass.
    center_m
        Its centre of mass.
    inertia_kg_m2
        About that centre: xx, yy, zz, and xy, xz, yz where they are not 0.
    """

    fixed: bool = False
    mass_kg: Equation | None = None
    center_m: Vector | None = None
    inertia_kg_m2: Annotated[tuple[Equation, ...], Field(min_length=3, max_length=6)] | None = None


class JointTable(Table):
    """A hinge from one body to another.

    Attributes
    ----------
    from_body, to_body
        It hangs `to_body` on `from_body`.
    axis, at_m
        Direction and a point of its axis, in `from_body`.
    axis_in_to, at_in_to_m
        The same in `to_body`, where they differ.
    stiffness_n_m_rad, damping_n_m_s_rad, rest_rad, torque_n_m
        Torque: ``-stiffness (angle - rest) - damping rate + torque``.
    guess_rad
        About where a trial begins.
    """

    from_body: str = Field(alias="from")
    to_body: str = Field(alias="to")
    axis: Vector
    at_m: Vector = _NOTHING
    axis_in_to: Vector | None = None
    at_in_to_m: Vector | None = None
    stiffness_n_m_rad: Equation = Expression.of(0.0)
    damping_n_m_s_rad: Equation = Expression.of(0.0)
    rest_rad: Equation = Expression.of(0.0)
    torque_n_m: Equation = Expression.of(0.0)
    guess_rad: Finite = 0.0


class ChainLoopTable(Table):
    """The loop.

    Attributes
    ----------
    joint
        The joint that closes it: it leads to a body that another joint holds already.
    stabilisation_rad_s
        How fast an error of the closure decays; 0 leaves it as it is.
    """

    joint: str
    stabilisation_rad_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 100.0


class ChainFile(SystemFile):
    """A model file with bodies on hinges."""

    gravity_m_s2: Vector = _NOTHING
    inputs: Annotated[dict[Name, InputTable], BeforeValidator(listed)] = {}
    parameters: dict[Name, Annotated[ParameterTable, alone("value")]] = {}
    bodies: dict[Name, BodyTable]
    joints: Annotated[dict[Name, JointTable], Field(min_length=1)]
    loop: ChainLoopTable | None = None
    outputs: Annotated[dict[Name, Annotated[OutputTable, alone("equation")]], Field(min_length=1)]


_ZERO = Expression.of(0.0)


def chain_model(file: ModelFile) -> ClosedChain:
    """Return the model of a file with bodies on hinges.

    Raises ModelError: all that does not hold, each with file, line, key, and for an equation the place in it.
    """
    given = file.read(ChainFile)
    tree = _tree(file, given)
    names = tree.joints
    states = (*names, *(f"{name}_rate" for name in names))
    inputs = inputs_of(given.inputs)
    outputs = tuple(
        Output(name, output.unit, CLOSED if OPENINGS & set(output.equation.names) else 0.0)
        for name, output in given.outputs.items()
    )
    parameters = tuple(
        parameter_of(name, parameter, parameter.value) for name, parameter in given.parameters.items()
    )
    places = places_of(file, states, inputs, parameters)
    _check_initial(file, given, states, outputs)

    settings = _settings(given, tree)
    readings = {("outputs", name): output.equation for name, output in given.outputs.items()}
    expressions: dict[KeyPath, Expression] = {
        path: expression for path, expression in settings if path
    } | readings
    _check_forces(file, expressions, names)
    for name in (measure for measure in MEASURES if measure in places):
        file.note(
            ("outputs",), f"{name} is what labrun calls a quantity of every such model", "choose another name"
        )
    known = places | dict.fromkeys(MEASURES, "")
    conditions = conditions_of(file, expressions, known, given.conditions)
    _check_constant(file, settings, places)
    _check_numbers(file, given, {parameter.name: parameter.value for parameter in parameters})
    file.refuse()
    refuse_unused(file, expressions, parameters, conditions)

    places |= {condition: f"p[{len(parameters) + index}]" for index, condition in enumerate(conditions)}
    places |= {f"force.{name}": f"force[{index}]" for index, name in enumerate(names)}
    springs = [given.joints[name].stiffness_n_m_rad for name in names]
    at = len(parameters) + len(conditions)
    made = functions([measure for _, measure in settings], list(readings.values()), springs, places, tree, at)
    sites = tuple(
        Site(name, "joint", name, f"{name}_rate", "", spring.text if spring.names else "")
        for name, spring in zip(names, springs, strict=True)
    )
    guesses = {name: given.joints[name].guess_rad for name in names}
    rules = {state: rule for state, rule in given.initial.items() if rule != AT_REST}
    model = ClosedChain(
        name=given.name,
        states=states,
        inputs=inputs,
        outputs=outputs,
        parameters=parameters,
        conditions=conditions,
        sites=sites,
        initial={**guesses, **dict.fromkeys(states[len(names) :], 0.0), **rules},
        derivative=made["derivative"],
        output=made["output"],
        site_values=made["site_values"],
        source=file.name,
        meanings=meanings_of(given.conditions),
        settings=made["settings"],
        at=at,
        tree=tree,
        guesses=guesses,
        resting=tuple(state for state, rule in given.initial.items() if rule == AT_REST),
        held=tuple(name for name in names if name in rules and rules[name] not in ("first", "free")),
    )
    return dataclasses.replace(model, effects=read_effects(file, given.effects, model))


def _tree(file: ModelFile, given: ChainFile) -> Tree:
    """Return which joint hangs on which, parents first; the joint that closes the loop is the last."""
    fixed = _fixed(file, given)
    closing = None if given.loop is None else given.loop.joint
    placed: dict[str, int] = {fixed: -1}
    order: list[str] = []
    parents: list[int] = []
    waiting = [name for name in given.joints if name != closing]
    while waiting:
        ready = next((name for name in waiting if given.joints[name].from_body in placed), None)
        if ready is None:
            lost = given.joints[waiting[0]].from_body
            hint = f"every chain of joints begins at {fixed}, and goes on from -> to"
            file.fail(("joints", waiting[0]), f"it hangs on {lost}, which no joint holds", hint)
        waiting.remove(ready)
        joint = given.joints[ready]
        if joint.to_body in placed:
            closes = f'[loop] joint = "{ready}" says that it closes the loop'
            hint = closes if closing is None else "labrun closes one loop"
            file.fail(("joints", ready, "to"), f"{joint.to_body} is held already", hint)
        parents.append(placed[joint.from_body])
        placed[joint.to_body] = len(order)
        order.append(ready)
    first, second = -1, -1
    if closing is not None:
        joint = given.joints[closing]
        _check_closing(file, closing, joint, fixed, placed)
        first, second = placed[joint.to_body], len(order)
        parents.append(placed[joint.from_body])
        order.append(closing)
    for body in (body_ for body_ in given.bodies if body_ not in placed):
        file.note(("bodies", body), "no joint holds it", "take it out, or name it in the `to` of a joint")
    file.refuse()
    bodies = tuple(given.joints[name].to_body for name in order)
    return Tree(given.name, tuple(order), bodies, tuple(parents), first, second)


def _fixed(file: ModelFile, given: ChainFile) -> str:
    """Return the body that does not move; refuse names that mean nothing, and bodies without mass."""
    fixed = [name for name, body in given.bodies.items() if body.fixed]
    if len(fixed) != 1:
        text = " and ".join(fixed) or "none"
        file.fail(("bodies",), f"one body does not move, and says fixed = true; here it is {text}")
    for name, joint in given.joints.items():
        for key, body in (("from", joint.from_body), ("to", joint.to_body)):
            if body not in given.bodies:
                file.note(("joints", name, key), f"there is no body {body!r}", suggest(body, given.bodies))
    if given.loop is not None and given.loop.joint not in given.joints:
        hint = suggest(given.loop.joint, given.joints)
        file.note(("loop", "joint"), f"there is no joint {given.loop.joint!r}", hint)
    for name, table in given.bodies.items():
        if not table.fixed and table.mass_kg is None and table.inertia_kg_m2 is None:
            file.note(("bodies", name), "it has neither mass_kg nor inertia_kg_m2", "give one of them")
    file.refuse()
    return fixed[0]


def _check_closing(
    file: ModelFile, name: str, table: JointTable, fixed: str, placed: Mapping[str, int]
) -> None:
    if table.from_body not in placed:
        file.fail(("joints", name), f"it hangs on {table.from_body}, which no joint holds")
    if table.to_body == fixed:
        hint = "let joints go on from the fixed body on both sides, and name one in the middle in [loop]"
        file.fail(("loop", "joint"), f"{name} leads to {fixed}, which has no mass to share", hint)
    if table.to_body not in placed:
        file.fail(("loop", "joint"), f"{name} closes nothing: only it holds {table.to_body}")


def _settings(given: ChainFile, tree: Tree) -> list[tuple[KeyPath, Expression]]:
    """Return all numbers of the compiled functions, in their order, with the keys that say them."""
    rate = given.loop.stabilisation_rad_s if given.loop is not None else 0.0
    vector = _vector(("gravity_m_s2",), given.gravity_m_s2)
    vector.append(((), Expression.of(rate)))
    for name in tree.joints:
        joint = given.joints[name]
        vector += _joint(("joints", name), joint)
        vector += _body(("bodies", joint.to_body), given.bodies[joint.to_body])
    return vector


def _joint(path: KeyPath, table: JointTable) -> list[tuple[KeyPath, Expression]]:
    vectors = {
        "axis": table.axis,
        "at_m": table.at_m,
        "axis_in_to": table.axis_in_to or table.axis,
        "at_in_to_m": table.at_in_to_m or table.at_m,
    }
    entries = [entry for key, vector in vectors.items() for entry in _vector((*path, key), vector)]
    torques = ("stiffness_n_m_rad", "damping_n_m_s_rad", "rest_rad", "torque_n_m")
    return entries + [((*path, key), getattr(table, key)) for key in torques]


def _body(path: KeyPath, table: BodyTable) -> list[tuple[KeyPath, Expression]]:
    inertia = [*(table.inertia_kg_m2 or ()), *[_ZERO] * 6][:6]
    entries = [((*path, "mass_kg"), table.mass_kg or _ZERO)]
    entries += _vector((*path, "center_m"), table.center_m or (_ZERO,) * 3)
    return entries + [((*path, "inertia_kg_m2", index), each) for index, each in enumerate(inertia)]


def _vector(path: KeyPath, values: Sequence[Expression]) -> list[tuple[KeyPath, Expression]]:
    return [((*path, index), value) for index, value in enumerate(values)]


def _check_initial(
    file: ModelFile, given: ChainFile, states: Sequence[str], outputs: tuple[Output, ...]
) -> None:
    for state, rule in given.initial.items():
        if rule == AT_REST and state.endswith("_rate") and state in states:
            file.note(("initial", state), f'"{AT_REST}" is for angles', "rates begin at 0")
    rules = {state: rule for state, rule in given.initial.items() if rule != AT_REST or state not in states}
    initial_of(file, rules, states, outputs)


def _check_forces(file: ModelFile, expressions: Expressions, joints: Sequence[str]) -> None:
    """Note a ``force.<joint>`` without its joint, or anywhere but in an output: labrun adds it at every joint."""
    for path, expression in expressions.items():
        for name, position in expression.names.items():
            joint = name.removeprefix("force.")
            if joint != name and path[0] != "outputs":
                reason = "labrun adds the force at every joint; it stands in outputs only"
            elif joint != name and joint not in joints:
                reason = f"there is no joint {joint!r}"
            elif name in MEASURES and path[0] != "outputs":
                reason = f"{name} stands in outputs only"
            else:
                continue
            file.note_in(path, ExpressionError(expression.text, reason, position))


def _check_numbers(file: ModelFile, given: ChainFile, known: Mapping[str, float]) -> None:
    """Note axes without direction and bodies that cannot be, as far as the parameters' values tell."""
    for name, joint in given.joints.items():
        for key in ("axis", "axis_in_to"):
            vector: Vector | None = getattr(joint, key)
            values = None if vector is None else _valued(file, ("joints", name, key), vector, known)
            if values is not None and not np.linalg.norm(values) > 0:
                file.note(("joints", name, key), "an axis needs a direction", "one number of it is not 0")
    for name, body in given.bodies.items():
        mass, inertia = body.mass_kg, body.inertia_kg_m2
        mass_kg = None if mass is None else _valued(file, ("bodies", name, "mass_kg"), mass, known)
        if mass_kg is not None and mass_kg[0] < 0:
            file.note(("bodies", name, "mass_kg"), f"{mass_kg[0]:g} kg, and a mass is at least 0")
        path = ("bodies", name, "inertia_kg_m2")
        values = None if inertia is None else _valued(file, path, inertia, known)
        if values is None:
            continue
        xx, yy, zz, xy, xz, yz = np.append(values, np.zeros(6 - len(values)))
        principal = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if principal[0] < -_ROUNDING * principal[-1]:
            moments = ", ".join(f"{moment:.3g}" for moment in principal)
            hint = "none is below 0; the order is xx, yy, zz, xy, xz, yz"
            file.note(
                path, f"no body has this inertia: about its principal axes it is {moments} kg m^2", hint
            )


def _valued(
    file: ModelFile, path: KeyPath, given: Expression | Sequence[Expression], known: Mapping[str, float]
) -> FloatArray | None:
    """Return the numbers of a key; None where they hang on more than is known, or one is none, which is noted."""
    equations = {path: given} if isinstance(given, Expression) else dict(_vector(path, given))
    if not known.keys() >= {name for equation in equations.values() for name in equation.names}:
        return None
    faults = []
    for key_path, equation in equations.items():
        try:
            faults.append(float(equation(known)))
        except ExpressionError as error:
            file.note_in(key_path, error)
            return None
    return np.array(faults)


def _check_constant(
    file: ModelFile, settings: Sequence[tuple[KeyPath, Expression]], places: dict[str, str]
) -> None:
    for path, expression in settings:
        if not path or path[-1] == "torque_n_m":
            continue
        for name, position in expression.names.items():
            if name == "t" or places.get(name, "p").startswith(("x", "u")):
                reason = f"bodies and hinges cannot depend on {name!r}, which moves"
                hint = "use parameters and conditions; torque_n_m may depend on everything"
                file.note_in(path, ExpressionError(expression.text, reason, position, hint))
