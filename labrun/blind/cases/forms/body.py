"""What a fluid does to a body beyond the model's drag."""

# ruff: noqa: ARG001 - the signatures are fixed, whatever of them a form uses

import numpy as np

from ..mechanism import Measures, Mechanism
from ..plant import At, FloatArray

_ECHO_STAGES = 8


def drag_error(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Drag larger than thought, with an exponent of 1.85 to 1.95."""
    power = rng.uniform(1.85, 1.95)

    def law(size: float, t: float, at: At) -> FloatArray:
        return -size * m.force * np.sign(at.rate) * (np.abs(at.rate) / m.v) ** power

    return Mechanism(
        "drag-error", site, "body", "drag with exponent below two", law,
        lambda s: {"coefficient": s * m.force / m.v**2, "exponent": power}, most=4.0,
    )  # fmt: skip


def reynolds_drag(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Drag of a laminar boundary layer and of creeping flow, added up."""
    laminar = rng.uniform(0.3, 0.7)

    def law(size: float, t: float, at: At) -> FloatArray:
        share = np.abs(at.rate) / m.v
        drag = laminar * share**1.5 + (1.0 - laminar) * share
        return -size * m.force * np.sign(at.rate) * drag

    return Mechanism(
        "reynolds-dependent-drag", site, "body", "laminar layer (exponent 1.5) and creeping flow (exponent 1)", law,
        lambda s: {"coefficient": s * m.force / m.v**2, "reference": m.v, "laminar_share": laminar}, most=4.0,
    )  # fmt: skip


def added_mass(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Water that moves along: nine tenths of it at once, the rest after a short while."""
    own, late = m.force / m.a, rng.uniform(0.05, 0.15)
    relax = m.period_s * rng.uniform(0.05, 0.15)

    def law(size: float, t: float, z: FloatArray, at: At) -> tuple[FloatArray, FloatArray]:
        behind = (at.rate - z) / relax
        return -size * own * late * behind[0], behind

    return Mechanism(
        "added-mass", site, "body", "added mass, a tenth of it with a relaxation", law,
        lambda s: {"mass": s * own, "late_share": late, "relaxation_s": relax}, most=2.0, states=1,
        mass=lambda s, at: np.full(at.rate.size, s * own * (1.0 - late)),
        fastest=lambda _s: 1.0 / relax,
    )  # fmt: skip


def wall_echo(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Waves that come back: late and spread out, through a chain of eight equal stages."""
    delay = float(np.exp(rng.uniform(np.log(0.3), np.log(1.2))))
    sign = float(rng.choice([-1, 1]))

    def law(size: float, t: float, z: FloatArray, at: At) -> tuple[FloatArray, FloatArray]:
        made = np.abs(at.rate) * at.rate / m.v**2
        entering = np.concatenate([made[None, :], z[:-1]])
        return sign * size * m.force * z[-1], (entering - z) * (_ECHO_STAGES / delay)

    return Mechanism(
        "wall-echo", site, "body", "dispersed echo: a chain of eight stages", law,
        lambda s: {"coefficient": sign * s * m.force / m.v**2, "delay": delay}, most=1.5, states=_ECHO_STAGES,
        fastest=lambda _s: _ECHO_STAGES / delay,
    )  # fmt: skip


def mean_current(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A current that breathes a little, and drag with an exponent below two on the speed through the water."""
    power, drag = rng.uniform(1.88, 1.95), rng.uniform(0.4, 1.2)
    sign, beat = float(rng.choice([-1, 1])), rng.uniform(0.15, 0.4)

    def law(size: float, t: float, at: At) -> FloatArray:
        through = at.rate - sign * size * m.v * (1.0 + 0.05 * np.sin(beat * t))

        def drag_of(v: FloatArray) -> FloatArray:
            return np.sign(v) * (np.abs(v) / m.v) ** power

        return drag * m.force * (drag_of(at.rate) - drag_of(through))

    return Mechanism(
        "mean-current", site, "body", "drag with exponent below two, in a current that varies by 5 %", law,
        lambda s: {"coefficient": drag * m.force / m.v**2, "speed": sign * s * m.v, "exponent": power}, most=1.2,
    )  # fmt: skip


BODY = {
    "drag-error": drag_error,
    "reynolds-dependent-drag": reynolds_drag,
    "added-mass": added_mass,
    "wall-echo": wall_echo,
    "mean-current": mean_current,
}
