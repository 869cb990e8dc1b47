"""Springs, dampers, inertia and stops at a joint."""

# ruff: noqa: ARG001 - the signatures are fixed, whatever of them a form uses

import numpy as np

from ..mechanism import Measures, Mechanism
from ..plant import At, FloatArray


def viscous(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Damping a little more or less than proportional to speed."""
    power = 1.0 + rng.uniform(0.04, 0.1) * rng.choice([-1, 1])
    return Mechanism(
        "viscous-damping", site, "joint", "power law near one",
        lambda s, _t, at: -s * m.force * np.sign(at.rate) * (np.abs(at.rate) / m.v) ** power,
        lambda s: {"coefficient": s * m.force / m.v, "exponent": power}, most=3.0,
    )  # fmt: skip


def quadratic_drag(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Drag with an exponent of 1.85 to 1.95."""
    power = rng.uniform(1.85, 1.95)
    return Mechanism(
        "quadratic-drag", site, "joint", "drag with exponent below two",
        lambda s, _t, at: -s * m.force * np.sign(at.rate) * (np.abs(at.rate) / m.v) ** power,
        lambda s: {"coefficient": s * m.force / m.v**2, "exponent": power}, most=4.0,
    )  # fmt: skip


def cubic(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Hardening spring: mostly cubic, with some fifth order."""
    fifth = rng.uniform(0.05, 0.15)
    return Mechanism(
        "cubic-stiffness", site, "joint", "third with some fifth order",
        lambda s, _t, at: -s * m.stiffness * m.q * ((at.coordinate / m.q) ** 3 + fifth * (at.coordinate / m.q) ** 5),
        lambda s: {"coefficient": s * m.stiffness / m.q**2, "fifth_order_share": fifth}, most=2.0,
    )  # fmt: skip


def asymmetric(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Another stiffness on one side: hyperbolic bend, or softening that sets in at a small angle (buckling)."""
    width = m.q * rng.uniform(0.03, 0.1)
    sign = float(rng.choice([-0.4, 1.0]))

    def force(s: float, _t: float, at: At) -> FloatArray:
        q = at.coordinate
        return -sign * s * m.stiffness * 0.5 * (q + np.sqrt(q * q + width * width) - width)

    return Mechanism(
        "asymmetric-stiffness", site, "joint", "hyperbolic bend", force,
        lambda s: {"excess": sign * s * m.stiffness, "bend_width": width}, most=2.0,
    )  # fmt: skip


def rest_offset(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A spring set to one side, its own force a little less there than linear."""
    sign = float(rng.choice([-1, 1]))
    return Mechanism(
        "rest-offset", site, "joint", "offset that grows slightly with the deflection",
        lambda s, _t, at: sign * s * at.stiffness * m.q * (1.0 + 0.03 * np.tanh(at.coordinate / m.q)),
        lambda s: {"offset": sign * s * m.q}, start=0.05, most=0.8,
    )  # fmt: skip


def constant_force(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A pull that changes a little over the stroke, as a cable's does."""
    sign, tilt = float(rng.choice([-1, 1])), rng.uniform(-0.05, 0.05)
    return Mechanism(
        "constant-force", site, "joint", "pull with a few percent of change over the stroke",
        lambda s, _t, at: sign * s * m.force * (1.0 + tilt * np.sin(at.coordinate / m.q)),
        lambda s: {"force": sign * s * m.force, "tilt": tilt}, start=0.05, most=1.5,
    )  # fmt: skip


def backlash(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Play in the spring, its edges rounded."""
    power = rng.uniform(5.0, 9.0)

    def force(s: float, _t: float, at: At) -> FloatArray:
        half = max(0.5 * s * m.q, 1e-12)
        share = at.coordinate / half
        return at.stiffness * at.coordinate / (1.0 + np.abs(share) ** power) ** (1.0 / power)

    return Mechanism(
        "backlash", site, "joint", "dead zone with rounded edges", force,
        lambda s: {"gap": s * m.q, "roundness": power}, most=1.2,
    )  # fmt: skip


def creep(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A spring that gives way: two Maxwell branches with relaxation times a factor of three apart."""
    middle = float(np.exp(rng.uniform(np.log(0.3 * m.period_s), np.log(min(1.5 * m.period_s, 2.0)))))
    times = middle * np.array([[0.58], [1.73]])
    shares = np.array([[0.6], [0.4]])

    def law(size: float, t: float, z: FloatArray, at: At) -> tuple[FloatArray, FloatArray]:
        stretch = at.coordinate - z
        return -size * m.stiffness * (shares * stretch).sum(axis=0), stretch / times

    return Mechanism(
        "viscoelastic-creep", site, "joint", "two Maxwell branches", law,
        lambda s: {"stiffness": s * m.stiffness, "time_constant": middle},
        start=0.15, most=2.0, states=2, fastest=lambda _s: 1.0 / float(times.min()),
    )  # fmt: skip


def added_inertia(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A mass on the joint whose inertia changes a little with the joint's position."""
    uneven = rng.uniform(0.03, 0.08)
    own = m.force / m.a

    def law(size: float, t: float, at: At) -> FloatArray:
        slope = -uneven / m.q * np.sin(at.coordinate / m.q)
        return -0.5 * size * own * slope * at.rate**2

    def mass(size: float, at: At) -> FloatArray:
        return size * own * (1.0 + uneven * np.cos(at.coordinate / m.q))

    return Mechanism(
        "added-inertia", site, "joint", "inertia that depends a little on position, by Lagrange", law,
        lambda s: {"inertia": s * own, "unevenness": uneven}, start=0.1, most=1.5, mass=mass,
    )  # fmt: skip


def end_stop(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Stops as elastic bodies: Hertz's contact with some loss, on one side or on both."""
    both = rng.random() < 0.5
    side = float(rng.choice([-1, 1]))
    hard, loss = rng.uniform(6.0, 20.0), rng.uniform(0.02, 0.15)
    scale = 0.15 * m.q

    def push(depth: FloatArray, speed: FloatArray) -> FloatArray:
        deep = np.maximum(depth, 0.0)
        force = hard * m.stiffness * deep * np.sqrt(deep / scale) * (1.0 + loss * speed / m.v)
        return np.maximum(force, 0.0)

    def force(s: float, _t: float, at: At) -> FloatArray:
        level = m.top * (1.0 - s)
        result = -side * push(side * at.coordinate - level, side * at.rate)
        if both:
            result = result + side * push(-side * at.coordinate - level, -side * at.rate)
        return result

    def values(s: float) -> dict[str, float]:
        level = m.top * (1.0 - s)
        places = {"upper": level} if side > 0 else {"lower": -level}
        both_places = {"upper": level, "lower": -level}
        return {**(both_places if both else places), "stiffness_at_depth": hard * m.stiffness, "depth": scale}

    return Mechanism(
        "end-stop", site, "joint", "Hertz contact with loss", force, values, start=0.15, most=0.7,
        fastest=lambda _s: 3.0 * np.sqrt(hard * m.stiffness * m.a / m.force),
    )  # fmt: skip


def cogging(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A force that repeats several times over the stroke, as of magnets and teeth, with a second harmonic."""
    waves, phase, second = (
        rng.uniform(2.5, 6.0) * np.pi / m.q,
        rng.uniform(0, 2 * np.pi),
        rng.uniform(0.05, 0.15),
    )

    def law(s: float, _t: float, at: At) -> FloatArray:
        angle = waves * at.coordinate + phase
        return s * m.force * (np.sin(angle) + second * np.sin(2.0 * angle))

    return Mechanism(
        "cogging", site, "joint", "with a second harmonic", law,
        lambda s: {
            "periods": waves, "sine": -s * m.force * np.cos(phase), "cosine": -s * m.force * np.sin(phase),
            "second_harmonic_share": second,
        },
        most=1.5, fastest=lambda _s: 0.5 * np.sqrt(waves * m.a) + m.v * waves * 0.2,
    )  # fmt: skip


JOINT = {
    "viscous-damping": viscous,
    "quadratic-drag": quadratic_drag,
    "cubic-stiffness": cubic,
    "asymmetric-stiffness": asymmetric,
    "rest-offset": rest_offset,
    "constant-force": constant_force,
    "backlash": backlash,
    "viscoelastic-creep": creep,
    "added-inertia": added_inertia,
    "end-stop": end_stop,
    "cogging": cogging,
}
