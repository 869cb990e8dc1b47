"""Bodies on hinges as a tree with at most one loop, and the short code generated around what is compiled for all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import IntArray
from labrun.compiled import NativeFunction, ThroughAddresses, equations, generated
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
    if any(name in measured for reading in readings for name in reading.names):
        text["readings"] = "@kernel\n" + equations("readings", readings, {**places, **measured})
        text["output"] = _OUTPUT.format(count=count, joints=joints, measured=len(MEASURES), at=at + 1)
    else:
        text["output"] = equations("output", readings, places)
    made = generated(text, _IMPORTS.format(tree=[float(number) for number in tree.numbers]))
    reaching = {name: ThroughAddresses("model", made[name].provide) for name in ("derivative", "output")}
    return {**made, **reaching}
