"""A model with MuJoCo's equations of motion: short generated code around precompiled functions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import NativeFunction, ThroughAddresses, equations, generated
from labrun.errors import ModelError
from labrun.models.mjcf.plant import MjcfLayout, plant
from labrun.models.model import Condition, Model
from labrun.toml import Expression

AT_REST = "rest"
"""Rule of a joint that begins where springs and weights leave it."""
_KEPT_STARTS = 1000
_IMPORTS = """\
from labrun.compiled import kernel
from labrun.models.mjcf.kernels import integers, numbers, reading, slope
from labrun.models.mjcf.plant import SCRATCH
"""
_AROUND = """\
def {name}(t, x, u, p, force, out):
    table = integers(int(p[{at}]))
    settings(t, x, u, p, force, numbers(table[SCRATCH]))
    {called}(table, x, u, force, out)
    return"""


def functions(
    settings: Sequence[Expression], quantities: Sequence[Expression], places: Mapping[str, str], at: int
) -> dict[str, NativeFunction]:
    """Return derivative, output and site_values.

    Parameters
    ----------
    settings
        The values that are written to the MJCF model.
    quantities
        Coordinate, rate, load and stiffness of every site.
    places
        Where each name is found in the arguments.
    at
        Index in `p` of the address of the table.
    """
    made = generated(
        {
            "settings": "@kernel\n" + equations("settings", settings, dict(places)),
            "derivative": _AROUND.format(name="derivative", called="slope", at=at),
            "output": _AROUND.format(name="output", called="reading", at=at),
            "site_values": equations("site_values", quantities, dict(places)),
        },
        _IMPORTS,
    )
    reaching = {name: ThroughAddresses("model", made[name].provide) for name in ("derivative", "output")}
    return {**reaching, "site_values": made["site_values"]}


@dataclass(frozen=True)
class MujocoModel(Model):
    """A model like any other: its functions ask MuJoCo for accelerations, labrun integrates.

    Attributes
    ----------
    layout
        The compiled MJCF model, and where in it states, inputs, outputs, sites and parameters are.
    mjcf
        The path of its MJCF file, or the file's text.
    closes
        Whether the MJCF file ties bodies together by ``connect`` or ``weld``, so that trials begin with closed loops.
    guesses : joint's position -> value
        Near which the search for rest begins.
    resting
        Positions that begin where springs and weights leave them.
    held
        Positions that begin exactly where `initial` says; the others move until the loops close.
    """

    layout: MjcfLayout = field(kw_only=True, repr=False)
    mjcf: str = field(kw_only=True, repr=False, default="")
    closes: bool = field(kw_only=True, default=False)
    guesses: Mapping[str, float] = field(kw_only=True, default_factory=dict)
    resting: tuple[str, ...] = field(kw_only=True, default=())
    held: tuple[str, ...] = field(kw_only=True, default=())
    # a fit begins the same trial again for every parameter that it tries
    _starts: dict[tuple[object, ...], FloatArray] = field(
        init=False, repr=False, compare=False, default_factory=dict
    )

    def vector(self, parameters: FloatArray | Mapping[str, float] | None, condition: Condition) -> FloatArray:
        """Return `p` as `Model.vector` does; its last number leads compiled code to this thread's MuJoCo.

        The vector is good for simulations in the process and thread that asked for it.

        Raises
        ------
        ModelError
            As `Model.vector`, and where the model's parameters were replaced by others.
        """
        p = super().vector(parameters, condition)
        if len(p) != self.layout.at:  # an address read from the wrong place would end the process
            raise ModelError(
                f"model {self.name} takes {self.layout.at} parameters and conditions, and now has {len(p)}",
                hint="in MuJoCo, a model's parameters can change their values, not their number",
            )
        # an address has at most 48 bits, and a float64 holds 53 exactly
        return np.append(p, float(plant(self.layout).address))

    def with_initial(self, rules: Mapping[str, float | str]) -> "MujocoModel":
        """Return the model with other rules of how trials begin."""
        resting = {*self.resting, *rules} - {name for name, rule in rules.items() if rule != AT_REST}
        held = {name for name, rule in rules.items() if rule not in ("first", "free", AT_REST)}
        begin = {name: self.guesses[name] if rule == AT_REST else rule for name, rule in rules.items()}
        return replace(
            self,
            initial={**self.initial, **begin},
            resting=tuple(name for name in self.states if name in resting),
            held=tuple(
                name for name in self.states if name in held or (name in self.held and name not in rules)
            ),
        )

    def initial_state(
        self,
        condition: Condition,
        *,
        first: Mapping[str, float] | None = None,
        free: Mapping[str, float] | None = None,
    ) -> FloatArray:
        """Return the state a trial begins in, shape (states,), with loops closed and joints at rest where they should.

        Parameters are the nominal ones. Arguments as in `Model.initial_state`.

        Raises
        ------
        ModelError
            As `Model.initial_state`; and where a loop cannot close, with how far it stays open.
        """
        state = super().initial_state(condition, first=first, free=free)
        if not (self.closes or self.resting):
            return state
        key = (state.tobytes(), *sorted(condition.items()))
        if key not in self._starts:
            if len(self._starts) >= _KEPT_STARTS:
                self._starts.clear()
            self._starts[key] = self._started(condition, state)
        return self._starts[key].copy()

    def _started(self, condition: Condition, state: FloatArray) -> FloatArray:
        from labrun.models.mjcf.closing import Linkage

        counts = (len(self.inputs), len(self.sites), len(self.states))
        u, force, slope = (np.zeros(max(1, count)) for count in counts)
        # the derivative leaves the condition's values and this state in the memory of the thread's simulation
        self.derivative.python(0.0, state, u, self.vector(None, condition), force, slope)
        simulation = plant(self.layout)
        linkage = Linkage(simulation.model, simulation.data, self.name)
        linkage.close(self._dofs(simulation.model, self.held, inverse=True))
        if self.resting:
            linkage.settle(self._dofs(simulation.model, self.resting))
        linkage.fit_rates()
        return np.array(
            [
                np.ravel(getattr(simulation.data, location.array))[location.index]
                for location in self.layout.states
            ]
        )

    def _dofs(self, model: Any, names: Sequence[str], *, inverse: bool = False) -> IntArray:
        """Return the degrees of freedom of the joints with these positions, or all others."""
        places = [self.layout.states[self.states.index(name)] for name in names]
        positions = [location.index for location in places if location.array == "qpos"]
        joints = np.searchsorted(model.jnt_qposadr, positions, side="right") - 1
        return np.flatnonzero(np.isin(model.dof_jntid, joints, invert=inverse))
