"""A model of bodies on hinges, whose trials begin where its loop is closed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import NativeFunction
from labrun.errors import ModelError
from labrun.models.chains.tree import Tree
from labrun.models.model import Condition, Model

AT_REST = "rest"
"""Rule of a joint that begins where springs and weights leave it."""
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
    # a fit begins the same trial again for every parameter that it tries
    _begun: dict[tuple[object, ...], FloatArray] = field(
        init=False, repr=False, compare=False, default_factory=dict
    )

    def numbers(
        self, parameters: FloatArray | Mapping[str, float] | None = None, condition: Condition | None = None
    ) -> FloatArray:
        """Return what the kernels take; torques are those at rest, at time 0, without inputs."""
        settings = self.settings.python
        count = len(self.tree.joints)
        result = np.zeros(_numbers_of(count))
        p = self.vector(parameters, condition or {})
        settings(0.0, np.zeros(2 * count), np.zeros(len(self.inputs)), p, np.zeros(count), result)
        return result

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
        initial = self._begun.get(asked)
        if initial is None:
            initial = self._closed(condition, state)
            if len(self._begun) >= _KEPT_STARTS:
                self._begun.clear()
            self._begun[asked] = initial
        return initial.copy()

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
