"""Physics that can be hidden in a bench, and the measures it is drawn by."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from .plant import At, FloatArray

Kind = Literal["joint", "body", "input", "output"]


@dataclass(frozen=True)
class Measures:
    """How large things are at a site, or how a signal runs, without anything hidden.

    Attributes
    ----------
    q, v, top
        Peak coordinate and speed of all but the largest half percent, and the largest coordinate of all (of a signal:
        the same of it and its rate).
    a
        Acceleration, root mean square.
    force
        A typical generalized force: of a joint its inertia times acceleration, root mean square.
    stiffness
        Force per coordinate; the site's own spring where it has one.
    other
        Peak of the next signal of the same kind; at a joint, of its load.
    row
        Which of the signals of its kind it is.
    """

    q: float
    v: float
    a: float
    force: float
    stiffness: float
    step_s: float
    length_s: float
    period_s: float
    other: float = 0.0
    row: int = 0
    top: float = 0.0


@dataclass(frozen=True)
class Mechanism:
    """One piece of physics at one site, its size still open.

    Attributes
    ----------
    effect
        The library's id for it; "" for physics that the library does not have.
    form
        What its equations really are.
    law
        ``law(size, t, z, at) -> (force, dz)`` at joints and bodies; at inputs and outputs
        ``law(size, t, z, now, signals) -> (signal, dz)``, `signals` being all of the same kind. z and dz have the shape
        (states, trials); a law without states takes and returns none.
    mass
        ``mass(size, at) -> (trials,)``: force in proportion to minus the acceleration, on top of `law`.
    shift_s
        ``shift_s(size)``: seconds by which a signal is late before `law` sees it.
    prepare
        ``prepare(size, step_s, signal) -> signal``: an input worked out beforehand on a fine grid (samples, trials),
        where an equation would be too stiff; `law` then sees the result.
    start, most
        Where a search for the size begins, and where it must end.
    fastest
        ``fastest(size)``: the fastest rate in it, 1/s, for choosing a step.
    values
        ``values(size)``: the true values, under the library's names where it has them.
    jumps_s
        Times at which it changes abruptly.
    """

    effect: str
    site: str
    kind: Kind
    form: str
    law: Callable[..., Any]
    values: Callable[[float], Mapping[str, float]]
    start: float = 0.1
    most: float = 1.0
    states: int = 0
    mass: Callable[[float, At], FloatArray] | None = None
    shift_s: Callable[[float], float] | None = None
    prepare: Callable[[float, float, FloatArray], FloatArray] | None = None
    fastest: Callable[[float], float] = lambda _size: 0.0
    jumps_s: tuple[float, ...] = field(default=())
    rough: bool = False


@dataclass(frozen=True)
class Hidden:
    """A mechanism of a certain size."""

    mechanism: Mechanism
    size: float

    def apply(self, t: float, z: FloatArray, *seen: Any) -> tuple[FloatArray, FloatArray | float]:
        """Return its force or signal at what it sees, and the derivative of its states."""
        law = self.mechanism.law
        return law(self.size, t, z, *seen) if self.mechanism.states else (law(self.size, t, *seen), 0.0)
