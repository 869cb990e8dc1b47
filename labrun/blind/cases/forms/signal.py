"""What happens to a signal on its way in, or on its way out."""

# ruff: noqa: ARG001 - the signatures are fixed, whatever of them a form uses

from collections.abc import Callable
from typing import Literal

import numpy as np

from ..mechanism import Measures, Mechanism
from ..plant import FloatArray

Way = Literal["input", "output"]


def _lag(way: Way) -> Callable[[str, Measures, np.random.Generator], Mechanism]:
    def make(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
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

    return make


def _delay(way: Way) -> Callable[[str, Measures, np.random.Generator], Mechanism]:
    def make(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
        """A true transport delay."""

        def law(size: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
            return now

        return Mechanism(
            "delay", site, way, "true transport delay", law, lambda s: {"delay": s * m.period_s},
            start=0.03, most=0.25, shift_s=lambda s: round(s * m.period_s, 6),
        )  # fmt: skip

    return make


def _saturation(way: Way) -> Callable[[str, Measures, np.random.Generator], Mechanism]:
    def make(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
        """A limit with a soft knee."""
        power = rng.uniform(8.0, 16.0)

        def change(s: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
            level = m.q * (1.0 - s)
            return np.asarray(now / (1.0 + np.abs(now / level) ** power) ** (1.0 / power))

        return Mechanism(
            "saturation", site, way, "soft knee", change,
            lambda s: {"level": m.q * (1.0 - s), "knee": power}, start=0.25, most=0.85,
        )  # fmt: skip

    return make


def _bias(way: Way) -> Callable[[str, Measures, np.random.Generator], Mechanism]:
    def make(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
        """An offset that settles by some percent in the first seconds."""
        sign, settle_s = float(rng.choice([-1, 1])), m.length_s * rng.uniform(0.1, 0.3)

        def change(s: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
            return now + float(sign * s * m.q * (1.0 - 0.06 * np.exp(-t / settle_s)))

        return Mechanism(
            "bias",
            site,
            way,
            "offset that settles by 6 %",
            change,
            lambda s: {"offset": sign * s * m.q},
            most=0.8,
            start=0.05,
        )

    return make


def _gain_error(way: Way) -> Callable[[str, Measures, np.random.Generator], Mechanism]:
    def make(site: str, m: Measures, rng: np.random.Generator) -> Mechanism:
        """A gain that is a few percent less wrong at the ends of the range."""
        sign, bend = float(rng.choice([-1, 1])), rng.uniform(0.03, 0.08)

        def change(s: float, t: float, now: FloatArray, signals: FloatArray) -> FloatArray:
            return now * (1.0 + sign * s * (1.0 - bend * (now / m.q) ** 2))

        return Mechanism(
            "gain-error",
            site,
            way,
            "gain error with a slight bend",
            change,
            lambda s: {"error": sign * s, "bend": bend},
            most=0.8,
        )

    return make


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


INPUT = {
    "delay": _delay("input"),
    "lag": _lag("input"),
    "saturation": _saturation("input"),
    "rate-limit": rate_limit,
    "dead-band": dead_band,
    "gain-error": _gain_error("input"),
    "bias": _bias("input"),
}
OUTPUT = {
    "bias": _bias("output"),
    "gain-error": _gain_error("output"),
    "lag": _lag("output"),
    "delay": _delay("output"),
    "drift": drift,
    "saturation": _saturation("output"),
    "cross-talk": cross_talk,
}
