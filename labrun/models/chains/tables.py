"""The tables of a model file with bodies, joints and a loop."""

# ruff: noqa: RUF012 - pydantic copies defaults

from typing import Annotated

from pydantic import BeforeValidator, Field

from labrun.models.tables import (
    Equation,
    Finite,
    InputTable,
    Name,
    OutputTable,
    ParameterTable,
    SystemFile,
    alone,
    listed,
)
from labrun.toml import Expression, Table

Vector = tuple[Equation, Equation, Equation]
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
