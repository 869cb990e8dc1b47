"""A model of bodies on hinges with a loop: short generated code around what is compiled once for all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import NativeFunction, ThroughAddresses, equations, generated
from labrun.errors import ModelError
from labrun.models.model import Condition, Model
from labrun.toml import Expression

CLOSED = 1e-9
"""A loop is closed within this, rad and m."""


@dataclass(frozen=True, slots=True)
class Tree:
    """What hangs on what.

    Attributes
    ----------
    model
        Its name.
    joints
        Their names, parents before children.
    bodies
        Of each joint, the body it places. The one that closes the loop is placed twice.
    parents
        Of each joint, which joint places the body it hangs on; -1 for the fixed body.
    first, second
        Which joints place the two copies of the closing body; -1 where there is no loop.
    """

    model: str
    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    parents: tuple[int, ...]
    first: int
    second: int

    @property
    def numbers(self) -> tuple[int, ...]:
        """As the kernels take it."""
        return (len(self.joints), self.first, self.second, *self.parents)

    @property
    def array(self) -> IntArray:
        """As the kernels take it."""
        return np.array(self.numbers, dtype=np.int64)


AT_REST = "rest"
"""Rule of a joint that begins where springs and weights leave it."""
MEASURES = ("loop_angle_rad", "loop_distance_m", "kinetic_energy_j", "potential_energy_j")
"""What outputs of such a model may name besides what those of any model may."""
OPENINGS = frozenset(MEASURES[:2])
"""How far the loop is open."""
_IMPORTS = """
from labrun.compiled import kernel
from labrun.models.engine.calling import call_model

TREE = np.array({tree})
"""
_DERIVATIVE = """\
def derivative(t, x, u, p, force, out):
    values = np.empty({count})
    settings(t, x, u, p, force, values)
    call_model(int(p[{at}]), t, x, values, TREE, force, out)
    return"""
_OUTPUT = """\
def output(t, x, u, p, force, out):
    values = np.empty({count})
    settings(t, x, u, p, force, values)
    seen = np.empty({joints} + {measured})
    call_model(int(p[{at}]), t, x, values, TREE, force, seen)
    for k in range({measured}):
        seen[{joints} + {measured} - 1 - k] = seen[{measured} - 1 - k]
    for k in range({joints}):
        seen[k] = force[k]
    readings(t, x, u, p, seen, out)
    return"""


def functions(
    settings: Sequence[Expression],
    readings: Sequence[Expression],
    springs: Sequence[Expression],
    places: Mapping[str, str],
    tree: Tree,
    at: int,
) -> dict[str, NativeFunction]:
    """Return derivative, output, site_values, and settings, which writes the numbers the kernels take.

    Parameters
    ----------
    settings
        In the order of `labrun.models.chains.geometry`.
    readings
        The outputs.
    springs
        Of each joint its stiffness.
    places
        Where each name is found in the arguments.
    at
        Where in `p` the addresses of the compiled dynamics stand.
    """
    count, joints = len(settings), len(tree.joints)
    measured = {name: f"force[{joints + index}]" for index, name in enumerate(MEASURES)}
    quantities = [
        quantity
        for joint, spring in zip(tree.joints, springs, strict=True)
        for quantity in (Expression.of(joint), Expression.of(f"{joint}_rate"), Expression.of(0.0), spring)
    ]
    text = {
        "settings": "@kernel\n" + equations("settings", settings, places),
        "derivative": _DERIVATIVE.format(count=count, at=at),
        "site_values": equations("site_values", quantities, places),
    }
    if any(name in measured for one in readings for name in one.names):
        text["readings"] = "@kernel\n" + equations("readings", readings, {**places, **measured})
        text["output"] = _OUTPUT.format(count=count, joints=joints, measured=len(MEASURES), at=at + 1)
    else:
        text["output"] = equations("output", readings, places)
    made = generated(text, _IMPORTS.format(tree=[float(one) for one in tree.numbers]))
    reaching = {name: ThroughAddresses("model", made[name].provide) for name in ("derivative", "output")}
    return {**made, **reaching}


_KEPT_STARTS = 1000


@dataclass(frozen=True)
class ClosedChain(Model):
    """A model like any other, which begins where its loop is closed.

    Attributes
    ----------
    settings
        Writes the numbers of bodies and hinges.
    at
        How many parameters and conditions there are.
    tree
        What hangs on what.
    guesses : joint -> rad
        About where a trial begins.
    resting
        Joints that begin where springs and weights leave them.
    held
        Joints that begin exactly where `initial` says; the others move until the loop closes.
    """

    settings: NativeFunction = field(kw_only=True, repr=False)
    at: int = field(kw_only=True)
    tree: Tree = field(kw_only=True)
    guesses: Mapping[str, float] = field(kw_only=True)
    resting: tuple[str, ...] = field(kw_only=True, default=())
    held: tuple[str, ...] = field(kw_only=True, default=())
    _begun: dict[tuple[object, ...], FloatArray] = field(
        init=False, repr=False, compare=False, default_factory=dict
    )  # a fit begins the same trial again for every parameter that it tries

    def numbers(
        self, parameters: FloatArray | Mapping[str, float] | None = None, condition: Condition | None = None
    ) -> FloatArray:
        """Return what the kernels take; torques are those at rest, at time 0, without inputs."""
        settings = self.settings.python
        count = len(self.tree.joints)
        found = np.zeros(_numbers_of(count))
        p = self.vector(parameters, condition or {})
        settings(0.0, np.zeros(2 * count), np.zeros(len(self.inputs)), p, np.zeros(count), found)
        return found

    def vector(self, parameters: FloatArray | Mapping[str, float] | None, condition: Condition) -> FloatArray:
        """Return `p` as `Model.vector` does; its last numbers lead compiled code to the dynamics of chains.

        The vector is good for simulations in the process that asked for it.

        Raises
        ------
        ModelError
            As `Model.vector`, and where the model's parameters were replaced by others.
        """
        from labrun.models.chains.dynamics import MEASURED, SLOPE

        p = super().vector(parameters, condition)
        if len(p) != self.at:  # an address read from the wrong place would end the process
            raise ModelError(
                f"model {self.name} takes {self.at} parameters and conditions, and now has {len(p)}",
                hint="the parameters of bodies and joints can get other values but not be others",
            )
        # an address has at most 48 bits, and a float64 holds 53 exactly
        return np.append(p, [float(SLOPE.address), float(MEASURED.address)])

    def initial_state(
        self,
        condition: Condition,
        *,
        first: Mapping[str, float] | None = None,
        free: Mapping[str, float] | None = None,
    ) -> FloatArray:
        """Return the state a trial begins in, shape (states,), with the loop closed in angles and rates.

        Parameters are the nominal ones. Arguments as in `Model.initial_state`.

        Raises
        ------
        ModelError
            As `Model.initial_state`; and where the loop cannot close, with how far it stays open.
        """
        state = super().initial_state(condition, first=first, free=free)
        asked = (state.tobytes(), *sorted(condition.items()))
        begun = self._begun.get(asked)
        if begun is None:
            begun = self._closed(condition, state)
            if len(self._begun) >= _KEPT_STARTS:
                self._begun.clear()
            self._begun[asked] = begun
        return begun.copy()

    def _closed(self, condition: Condition, state: FloatArray) -> FloatArray:
        from labrun.models.chains.starting import closed, moving_together, settled

        count = len(self.tree.joints)
        values = self.numbers(None, condition)
        resting = self._places(self.resting)
        angles = closed(self.tree, values, state[:count], self._places(self.held))
        if resting.size:
            angles = settled(self.tree, values, angles, resting)
        return np.concatenate([angles, moving_together(self.tree, values, angles, state[count:])])

    def with_initial(self, rules: Mapping[str, float | str]) -> "ClosedChain":
        """Return the model with other rules of how trials begin."""
        begin = {name: rule for name, rule in rules.items() if rule != AT_REST}
        initial = {**self.initial, **{name: self.guesses.get(name, 0.0) for name in rules}, **begin}
        return replace(
            self,
            initial=initial,
            resting=tuple(
                n for n in self.tree.joints if rules.get(n, AT_REST if n in self.resting else "") == AT_REST
            ),
            held=tuple(
                n
                for n in self.tree.joints
                if (n in begin and begin[n] not in ("first", "free")) or (n in self.held and n not in rules)
            ),
        )

    def opening(self, angles: ArrayLike, parameters: Mapping[str, float] | None = None) -> FloatArray:
        """Return how far the loop is open at these angles: rad and m.

        Parameters
        ----------
        angles : (..., joints)
            rad, in the order of `Tree.joints`.

        Returns
        -------
        (..., 2)
        """
        from labrun.models.chains.starting import opening

        given = np.asarray(angles, dtype=float)
        count = len(self.tree.joints)
        if given.shape[-1] != count:
            raise ModelError(
                f"model {self.name} has {count} joints; angles of shape {given.shape} were given"
            )
        values = self.numbers(parameters, dict.fromkeys(self.conditions, 0.0))
        rows = [opening(self.tree, values, row) for row in given.reshape(-1, count)]
        return np.array(rows).reshape(*given.shape[:-1], 2)

    def turns(self, angles: FloatArray, parameters: Mapping[str, float] | None = None) -> FloatArray:
        """Return how every body is turned, shape (samples, joints, 3, 3), against how it lies when all angles are 0.

        Parameters
        ----------
        angles : (samples, joints)
            rad. The body of column k is ``tree.bodies[k]``.
        """
        from labrun.models.chains.starting import turns

        return turns(self.tree, self.numbers(parameters, dict.fromkeys(self.conditions, 0.0)), angles)

    def _places(self, names: Sequence[str]) -> IntArray:
        return np.array(
            [self.tree.joints.index(name) for name in names if name in self.tree.joints], dtype=np.int64
        )


def _numbers_of(joints: int) -> int:
    from labrun.models.chains.geometry import FIRST_JOINT, PER_JOINT

    return FIRST_JOINT + PER_JOINT * joints
