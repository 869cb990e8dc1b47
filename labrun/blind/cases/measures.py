"""How large things are in a bench before anything is hidden in it."""

import numpy as np

from .bench import Bench
from .mechanism import Kind, Measures
from .plant import FloatArray
from .simulate import march


def _peak(values: FloatArray) -> float:
    return float(max(np.quantile(np.abs(values), 0.995), 1e-9))


def _rms(values: FloatArray) -> float:
    return float(max(np.sqrt(np.mean(values**2)), 1e-12))


def measure(bench: Bench, outputs: FloatArray, kind: Kind, site: str) -> Measures:
    """Return the measures of a site, from a bench without anything hidden and its outputs."""
    plant, time_s = bench.plant, bench.time_s
    step_s, length_s = float(time_s[1] - time_s[0]), float(time_s[-1])
    if kind in ("joint", "body"):
        return _of_joint(bench, outputs, site, step_s, length_s)
    names = [one.name for one in (plant.inputs if kind == "input" else plant.outputs)]
    signals = bench.drive.inputs if kind == "input" else outputs
    row = names.index(site)
    q = _peak(signals[row])
    other = _peak(signals[(row + 1) % len(names)])
    period = _period(bench, outputs, step_s)
    fastest = min(_peak(np.diff(signals[row], axis=0) / step_s), 20.0 * np.pi * q / period)
    return Measures(
        q, fastest, 1.0, 1.0, 1.0, step_s, length_s, period, other, row, float(np.max(np.abs(signals[row])))
    )


def _period(bench: Bench, outputs: FloatArray, step_s: float) -> float:
    """Return the period in which a bench moves, from its sites where it has any motion of its own."""
    if bench.plant.states:
        return _of_joint(bench, outputs, bench.plant.sites[0].name, step_s, 1.0).period_s
    signal = bench.drive.inputs[0]
    spread, speed = _rms(signal - signal.mean(axis=0)), _rms(np.diff(signal, axis=0) / step_s)
    return float(np.clip(2 * np.pi * spread / speed, 0.2, 4.0))


def _of_joint(bench: Bench, outputs: FloatArray, site: str, step_s: float, length_s: float) -> Measures:
    plant = bench.plant
    row = plant.rate_row(site)
    states = march(bench, bench.initial(), 2) if plant.states else {}
    q, v, a, load, stiffness, push = [], [], [], [], [], 1.0
    for t in bench.time_s[:: max(1, len(bench.time_s) // 400)]:
        x = states[round(float(t), 9)] if plant.states else np.zeros((0, bench.trials))
        u = bench.drive.at(float(t), float(t))
        at = plant.at(site, x, u, bench.p)
        q.append(at.coordinate)
        v.append(at.rate)
        load.append(at.load)
        stiffness.append(at.stiffness)
        if row is not None:
            without = plant.rates(x, u, bench.p, bench.zero)[row]
            pushed = plant.rates(x, u, bench.p, {**bench.zero, site: bench.zero[site] + 1.0})[row]
            a.append(without)
            push = float(np.mean(pushed - without))
    spread, speed = _rms(np.array(q) - np.mean(q, axis=0)), _rms(np.array(v))
    period = float(np.clip(2 * np.pi * spread / speed, 0.2, 4.0))
    peak = _peak(np.array(q))
    acceleration = _rms(np.array(a)) if a else _rms(np.array(v)) / period
    force = acceleration / push if a else _rms(outputs[0])
    own = float(np.mean(stiffness))
    return Measures(
        peak, _peak(np.array(v)), acceleration, force, own if own > 0 else force / spread,
        step_s, length_s, period, _peak(np.array(load)), top=float(np.max(np.abs(q))),
    )  # fmt: skip
