"""What hangs on what in a chain of bodies, and when its loop is closed."""

from dataclasses import dataclass

import numpy as np

from labrun.arrays import IntArray

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
