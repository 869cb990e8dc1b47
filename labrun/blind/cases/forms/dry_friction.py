"""Friction that does not vanish with speed: bristles, elements in parallel, loads."""

# ruff: noqa: ARG001 - the signatures are fixed, whatever of them a form uses

import numpy as np

from ..mechanism import Measures, Mechanism
from ..plant import At, FloatArray


def _bristle(v: FloatArray, z: FloatArray, length: float, level: FloatArray | float = 1.0) -> FloatArray:
    """Return dz/dt of a LuGre bristle whose deflection z is in units of its breakaway `length`."""
    return (v - np.abs(v) * z / level) / length


def coulomb(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Friction of constant size: LuGre, with bristles far shorter than the motion and no Stribeck peak."""
    length = m.q * rng.uniform(0.003, 0.01)
    relax = length / m.v * rng.uniform(0.05, 0.2)

    def law(size: float, t: float, z: FloatArray, at: At) -> tuple[FloatArray, FloatArray]:
        dz = _bristle(at.rate, z, length)
        return -size * m.force * (z[0] + relax * dz[0]), dz

    return Mechanism(
        "coulomb-friction", site, "joint", "LuGre with short bristles", law,
        lambda s: {"torque": s * m.force, "bristle_length": length, "bristle_relaxation_s": relax},
        start=0.1, most=1.5, states=1, fastest=lambda _s: m.v / length, rough=True,
    )  # fmt: skip


def stribeck(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Friction greater at rest than in motion: rounded sign, exponent below two, peak of 1 to 2.5 times the level."""
    speed, edge = m.v * rng.uniform(0.08, 0.25), m.v * rng.uniform(0.008, 0.02)
    excess, power = rng.uniform(1.0, 2.5), rng.uniform(1.0, 1.6)

    def law(size: float, t: float, at: At) -> FloatArray:
        v = at.rate
        level = 1.0 + excess * np.exp(-((np.abs(v) / speed) ** power))
        return -size * m.force * level * v / np.sqrt(v * v + edge * edge)

    return Mechanism(
        "stribeck-friction", site, "joint", "algebraic rounded sign, Stribeck peak with its own exponent", law,
        lambda s: {
            "torque": s * m.force, "static_excess": excess, "stribeck_speed": speed,
            "exponent": power, "edge_speed": edge,
        },
        start=0.08, most=1.0, fastest=lambda s: s * (1 + excess) * m.a / edge, rough=True,
    )  # fmt: skip


def presliding(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Friction that yields before it slides: Dahl's law of exponent other than one, with a small Stribeck drop."""
    length, power = m.q * rng.uniform(0.04, 0.15), rng.uniform(0.6, 1.4)
    speed, excess = m.v * rng.uniform(0.05, 0.2), rng.uniform(0.1, 0.4)

    def law(size: float, t: float, z: FloatArray, at: At) -> tuple[FloatArray, FloatArray]:
        v = at.rate
        level = 1.0 + excess * np.exp(-np.abs(v) / speed)
        share = z / level * np.sign(v)
        pull = 1.0 - np.sign(share) * np.abs(share) ** power
        return -size * m.force * z[0], v * np.sign(pull) * np.abs(pull) / length

    return Mechanism(
        "presliding-friction", site, "joint", "Dahl with an exponent of its own and a Stribeck level", law,
        lambda s: {
            "torque": s * m.force, "presliding": length, "exponent": power, "static_excess": excess,
            "stribeck_speed": speed,
        },
        start=0.1, most=1.5, states=1, fastest=lambda _s: 2 * m.v / length, rough=True,
    )  # fmt: skip


def hysteresis(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Material hysteresis: Iwan's model, elastic-plastic elements in parallel that yield one after another."""
    count = 5
    middle = m.q * rng.uniform(0.15, 0.45)
    yields = middle * np.geomspace(0.4, 2.0, count)[:, None]
    sharp = 8.0

    def law(size: float, t: float, z: FloatArray, at: At) -> tuple[FloatArray, FloatArray]:
        v = at.rate
        share = z * np.sign(v)
        # an element moves with the joint until its force is what it can bear, then it stays behind
        dz = v * (1.0 - np.where(share > 0, np.minimum(np.abs(share), 1.5) ** sharp, 0.0)) / yields
        return -size * m.force * z.mean(axis=0), dz

    return Mechanism(
        "hysteresis", site, "joint", "Iwan: five elastic-plastic elements in parallel", law,
        lambda s: {"force": s * m.force, "yield_displacement": middle, "elements": float(count)},
        start=0.15, most=2.0, states=count, fastest=lambda _s: sharp * m.v / float(yields.min()), rough=True,
    )  # fmt: skip


def load_dependent(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Friction in proportion to the load, by a short bristle, the load rounded near zero."""
    length = m.q * rng.uniform(0.004, 0.012)

    def law(size: float, t: float, z: FloatArray, at: At) -> tuple[FloatArray, FloatArray]:
        load = np.sqrt(at.load**2 + (0.02 * m.other) ** 2)
        return -size * load * z[0], _bristle(at.rate, z, length)

    return Mechanism(
        "load-dependent-friction", site, "joint", "Dahl bristle times rounded load", law,
        lambda s: {"coefficient": s, "bristle_length": length},
        start=0.05, most=1.0, states=1, fastest=lambda _s: m.v / length, rough=True,
    )  # fmt: skip


def asymmetric(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Friction with a level for each direction: algebraic rounded sign, the level gliding from one to the other."""
    edge = m.v * rng.uniform(0.008, 0.02)
    one_sided = float(rng.uniform(0.3, 0.8) * rng.choice([-1, 1]))

    def law(size: float, t: float, at: At) -> FloatArray:
        v = at.rate
        # an arctangent has long tails: either level is reached later than the sign is
        level = 1.0 + one_sided * 2.0 / np.pi * np.arctan(v / (0.5 * edge))
        return -size * m.force * level * v / np.sqrt(v * v + edge * edge)

    return Mechanism(
        "asymmetric-friction", site, "joint", "algebraic rounded sign, level by an arctangent of the speed", law,
        lambda s: {"torque": s * m.force, "asymmetry": one_sided, "edge_speed": edge},
        start=0.1, most=1.2, fastest=lambda s: s * (1 + abs(one_sided)) * m.a / edge, rough=True,
    )  # fmt: skip


DRY_FRICTION = {
    "coulomb-friction": coulomb,
    "stribeck-friction": stribeck,
    "presliding-friction": presliding,
    "hysteresis": hysteresis,
    "load-dependent-friction": load_dependent,
    "asymmetric-friction": asymmetric,
}
