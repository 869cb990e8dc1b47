"""Physics of the library at joints and bodies, in forms that differ from the library's."""

# ruff: noqa: ARG001 - the signatures are fixed, whatever of them a form uses

import numpy as np

from ..plant import At, FloatArray, Measures, Mechanism


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


def asymmetric_friction(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
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
    "asymmetric-friction": asymmetric_friction,
}


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


def asymmetric_stiffness(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
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
    "asymmetric-stiffness": asymmetric_stiffness,
    "rest-offset": rest_offset,
    "constant-force": constant_force,
    "backlash": backlash,
    "viscoelastic-creep": creep,
    "added-inertia": added_inertia,
    "end-stop": end_stop,
    "cogging": cogging,
}


_ECHO_STAGES = 8


def drag_error(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Drag larger than thought, by 3 to 8 % more backwards; another exponent would be drag that depends on Reynolds."""
    aft = rng.uniform(0.03, 0.08)

    def law(size: float, t: float, at: At) -> FloatArray:
        return -size * m.force * np.sign(at.rate) * (at.rate / m.v) ** 2 * np.where(at.rate < 0, 1 + aft, 1.0)

    return Mechanism(
        "drag-error", site, "body", "square of speed, somewhat more backwards", law,
        lambda s: {"coefficient": s * m.force / m.v**2, "aft": aft}, most=4.0,
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
