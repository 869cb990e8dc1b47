"""The states of a compiled MJCF model: what they are called, where they are, where their derivatives are."""

import re
from dataclasses import dataclass

from labrun.models.fields import Fields
from labrun.models.mjcf.elements import Elements, ReferenceProblem
from labrun.models.mjcf.plant import Place


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


def read_states(fields: Fields, elements: Elements) -> States:
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
