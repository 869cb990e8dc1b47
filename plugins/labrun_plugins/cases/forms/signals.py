"""What happens to a signal on its way in or out; and physics that the library does not have."""

# ruff: noqa: ARG001, ARG005 - the signatures are fixed, whatever of them a form uses

from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np

from ..plant import At, FloatArray, Kind, Measures, Mechanism

Way = Literal["input", "output"]


def lag(way: Way, site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Two poles in a row, the second two to three times as fast."""
    ratio = rng.uniform(0.3, 0.6)

    def law(
        size: float, t: float, z: FloatArray, now: FloatArray, signals: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        constant = size * m.period_s
        return z[1], np.array([(now - z[0]) / (constant * ratio), (z[0] - z[1]) / constant])

    return Mechanism(
        "lag", site, way, "two poles", law,
        lambda s: {"time_constant": s * m.period_s * (1 + ratio), "second_pole_share": ratio},
        start=0.03, most=0.3, states=2, fastest=lambda s: 1.0 / (s * m.period_s * ratio),
    )  # fmt: skip


def delay(way: Way, site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A true transport delay."""

    def law(size: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
        return now

    return Mechanism(
        "delay", site, way, "true transport delay", law, lambda s: {"delay": s * m.period_s},
        start=0.03, most=0.25, shift_s=lambda s: round(s * m.period_s, 6),
    )  # fmt: skip


def saturation(way: Way, site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A limit with a soft knee."""
    power = rng.uniform(8.0, 16.0)

    def change(s: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
        level = m.q * (1.0 - s)
        return np.asarray(now / (1.0 + np.abs(now / level) ** power) ** (1.0 / power))

    return Mechanism(
        "saturation", site, way, "soft knee", change,
        lambda s: {"level": m.q * (1.0 - s), "knee": power}, start=0.25, most=0.85,
    )  # fmt: skip


def bias(way: Way, site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """An offset that settles by some percent in the first seconds."""
    sign, settle_s = float(rng.choice([-1, 1])), m.length_s * rng.uniform(0.1, 0.3)

    def change(s: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
        return now + float(sign * s * m.q * (1.0 - 0.06 * np.exp(-t / settle_s)))

    return Mechanism(
        "bias", site, way, "offset that settles by 6 %", change, lambda s: {"offset": sign * s * m.q},
        most=0.8, start=0.05,
    )  # fmt: skip


def gain_error(way: Way, site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A gain that is a few percent less wrong at the ends of the range."""
    sign, bend = float(rng.choice([-1, 1])), rng.uniform(0.03, 0.08)

    def change(s: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
        return now * (1.0 + sign * s * (1.0 - bend * (now / m.q) ** 2))

    return Mechanism(
        "gain-error", site, way, "gain error with a slight bend", change,
        lambda s: {"error": sign * s, "bend": bend}, most=0.8,
    )  # fmt: skip


def rate_limit(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A limit of speed that is not quite the same up and down."""
    uneven = rng.uniform(0.02, 0.06) * float(rng.choice([-1, 1]))

    def limit(size: float) -> float:
        return m.v * (1.0 - size) ** 2

    def prepare(size: float, step_s: float, signal: FloatArray) -> FloatArray:
        up, down = limit(size) * step_s * (1.0 + uneven), -limit(size) * step_s * (1.0 - uneven)
        result = signal.copy()
        for index in range(1, len(signal)):
            result[index] = result[index - 1] + np.clip(signal[index] - result[index - 1], down, up)
        return result

    def law(size: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
        return now

    return Mechanism(
        "rate-limit", site, "input", "limit that differs by some percent up and down", law,
        lambda s: {"rate": limit(s), "unevenness": uneven}, start=0.3, most=0.97, prepare=prepare, rough=True,
    )  # fmt: skip


def dead_band(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A dead zone with rounded edges."""
    power = rng.uniform(5.0, 9.0)

    def change(s: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
        return np.asarray(now - now / (1.0 + np.abs(now / (s * m.q)) ** power) ** (1.0 / power))

    return Mechanism(
        "dead-band", site, "input", "dead zone with rounded edges", change,
        lambda s: {"half_width": s * m.q, "roundness": power}, most=0.7,
    )  # fmt: skip


def drift(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A zero that creeps, more slowly as it goes."""
    sign, settle_s = float(rng.choice([-1, 1])), m.length_s * rng.uniform(1.2, 2.5)

    def change(s: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
        return now + float(sign * s * m.q * settle_s / m.length_s * (1.0 - np.exp(-t / settle_s)))

    return Mechanism(
        "drift", site, "output", "creep of the zero that tires", change,
        lambda s: {"slope": sign * s * m.q / m.length_s, "settling_s": settle_s}, most=0.8,
    )  # fmt: skip


def cross_talk(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Some of the next signal in this one, with a slight bend."""
    sign, bend = float(rng.choice([-1, 1])), rng.uniform(0.03, 0.08)

    def change(s: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
        other = signals[(m.row + 1) % len(signals)]
        return np.asarray(now + sign * s * m.q / m.other * other * (1.0 - bend * (other / m.other) ** 2))

    return Mechanism(
        "cross-talk", site, "output", "share of the next signal, with a slight bend", change,
        lambda s: {"share": sign * s * m.q / m.other, "bend": bend}, most=0.8,
    )  # fmt: skip


INPUT: dict[str, Callable[[str, Measures, np.random.Generator], Mechanism]] = {
    "delay": partial(delay, "input"),
    "lag": partial(lag, "input"),
    "saturation": partial(saturation, "input"),
    "rate-limit": rate_limit,
    "dead-band": dead_band,
    "gain-error": partial(gain_error, "input"),
    "bias": partial(bias, "input"),
}
OUTPUT: dict[str, Callable[[str, Measures, np.random.Generator], Mechanism]] = {
    "bias": partial(bias, "output"),
    "gain-error": partial(gain_error, "output"),
    "lag": partial(lag, "output"),
    "delay": partial(delay, "output"),
    "drift": drift,
    "saturation": partial(saturation, "output"),
    "cross-talk": cross_talk,
}


def _force(
    name: str,
    site: str,
    kind: Kind,
    force: Callable[[float, float, At], FloatArray],
    values: dict[str, float],
    jumps_s: tuple[float, ...] = (),
    fastest: float = 0.0,
) -> Mechanism:
    return Mechanism(
        "", site, kind, name, force, lambda s: {"size": s, **values}, most=1.5, jumps_s=jumps_s,
        fastest=lambda _s: fastest,
    )  # fmt: skip


def pulsating_stiffness(site: str, kind: Kind, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A spring whose stiffness is modulated in time."""
    pump = 2 * np.pi / m.period_s * rng.uniform(0.5, 1.9)
    return _force(
        "pulsating-stiffness", site, kind,
        lambda s, t, at: -s * m.stiffness * at.coordinate * np.sin(pump * t), {"pump_rad_s": pump},
    )  # fmt: skip


def second_mode(site: str, kind: Kind, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A lightly damped mass on a spring that rides on the joint (flexible link)."""
    omega = 2 * np.pi / m.period_s * rng.uniform(1.4, 3.0)
    zeta, own = rng.uniform(0.01, 0.04), m.force / m.a

    def law(size: float, t: float, z: FloatArray, at: At) -> tuple[FloatArray, FloatArray]:
        pull = omega**2 * (z[0] - at.coordinate) + 2 * zeta * omega * (z[1] - at.rate)
        return 0.5 * size * own * pull, np.array([z[1], -pull])

    return Mechanism(
        "", site, kind, "second-mode", law,
        lambda s: {"mass_share": 0.5 * s, "rad_s": omega, "damping_ratio": zeta},
        most=1.5, states=2, fastest=lambda _s: 2 * omega,
    )  # fmt: skip


def flutter(site: str, kind: Kind, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Damping that feeds energy in at small deflections and takes it out at large ones (van der Pol)."""
    turn = m.q * rng.uniform(0.3, 0.6)
    return _force(
        "flutter", site, kind,
        lambda s, t, at: s * m.force / m.v * at.rate * (1.0 - np.minimum((at.coordinate / turn) ** 2, 4.0)),
        {"turning_point": turn},
    )  # fmt: skip


def detent(site: str, kind: Kind, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A catch at one place of the stroke: attraction within a narrow region."""
    position, width = m.q * rng.uniform(0.2, 0.6) * rng.choice([-1, 1]), m.q * rng.uniform(0.08, 0.18)

    def force(s: float, t: float, at: At) -> FloatArray:
        away = (at.coordinate - position) / width
        return np.asarray(-2.0 * s * m.force * away * np.exp(-(away**2)))

    return _force("detent", site, kind, force, {"place": position, "width": width}, fastest=m.v / width)


def shaken_base(site: str, kind: Kind, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A machine next door: a force at its own frequency, in step with the start of the trial."""
    omega, phase = 2 * np.pi / m.period_s * rng.uniform(0.6, 2.7), rng.uniform(0, 2 * np.pi)
    return _force(
        "shaken-base", site, kind,
        lambda s, t, at: np.full_like(at.rate, s * m.force * np.sin(omega * t + phase)), {"rad_s": omega},
    )  # fmt: skip


def slipping(site: str, kind: Kind, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A clamp that slips now and then, at random times, either way, and takes the rest position along."""
    times = np.sort(rng.uniform(0.08, 0.95, 5)) * m.length_s
    moves = rng.choice([-1.0, 1.0], 5) * rng.uniform(0.5, 1.0, 5)
    rounded = np.round(times, 4)

    def force(s: float, t: float, at: At) -> FloatArray:
        # the instants are corners of the integration, each seen from the piece that follows it
        return np.full_like(at.rate, s * m.stiffness * m.q * float(moves[rounded <= t + 1e-12].sum()))

    return _force(
        "slipping-clamp", site, kind, force, {f"slip_{index + 1}_s": float(jump) for index, jump in enumerate(rounded)},
        jumps_s=tuple(float(jump) for jump in rounded),
    )  # fmt: skip


def warming(site: str, kind: Kind, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Damping that comes and goes with temperature in every trial: large at first, negative in the end."""
    settle = m.length_s * rng.uniform(0.15, 0.35)
    return _force(
        "warming-damper", site, kind,
        lambda s, t, at: -s * m.force / m.v * at.rate * (2.0 * np.exp(-t / settle) - 0.6), {"settling_s": settle},
    )  # fmt: skip


def gyroscopic(site: str, kind: Kind, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A force of position times speed: unbalance that pulls one way."""
    sign = float(rng.choice([-1, 1]))
    return _force(
        "position-times-speed", site, kind,
        lambda s, t, at: sign * s * m.force * 2.0 * at.coordinate / m.q * np.abs(at.rate) / m.v * np.sign(at.rate)
        + sign * s * m.force * (at.rate / m.v) ** 2,
        {"sign": sign},
    )  # fmt: skip


OUTSIDE = {
    "pulsating-stiffness": pulsating_stiffness,
    "second-mode": second_mode,
    "flutter": flutter,
    "detent": detent,
    "shaken-base": shaken_base,
    "slipping-clamp": slipping,
    "warming-damper": warming,
    "position-times-speed": gyroscopic,
}


def fifth_order(site: str, kind: Kind, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A linkage that turns the command by more, the further it goes, and not the same to both sides."""
    even = rng.uniform(0.4, 0.9) * float(rng.choice([-1, 1]))

    def law(size: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
        share = now / m.q
        return now + size * m.q * (share**5 + even * share**2)

    return Mechanism(
        "", site, kind, "fifth-order-linkage", law, lambda s: {"size": s, "even": even}, most=1.0
    )


def resonance(site: str, kind: Kind, m: Measures, rng: np.random.Generator) -> Mechanism:
    """A sensor or an amplifier with a weakly damped resonance of its own, mixed in."""
    omega, zeta = 2 * np.pi / m.period_s * rng.uniform(2.0, 4.0), rng.uniform(0.03, 0.08)

    def law(
        size: float, t: float, z: FloatArray, now: FloatArray, signals: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        pull = omega**2 * (now - z[0]) - 2 * zeta * omega * z[1]
        return (1.0 - size) * now + size * z[0], np.array([z[1], pull])

    return Mechanism(
        "", site, kind, "own-resonance", law, lambda s: {"share": s, "rad_s": omega, "damping_ratio": zeta},
        most=1.0, states=2, fastest=lambda _s: 2 * omega,
    )  # fmt: skip


def hum(site: str, kind: Kind, m: Measures, rng: np.random.Generator) -> Mechanism:
    """Gain that goes up and down in time, in step with the start of the trial."""
    omega = 2 * np.pi / m.period_s * rng.uniform(0.3, 2.2)

    def law(size: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
        return np.asarray(now * (1.0 + size * np.sin(omega * t)))

    return Mechanism("", site, kind, "pulsating-gain", law, lambda s: {"size": s, "rad_s": omega}, most=1.0)


OUTSIDE_SIGNALS = {"fifth-order-linkage": fifth_order, "own-resonance": resonance, "pulsating-gain": hum}
