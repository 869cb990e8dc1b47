"""A plant with its trials, its inputs and what is hidden in it: the equations as one integration sees them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .plant import Between, FloatArray, Hidden, Plant, Programme


class Drive:
    """Inputs of all trials.

    Parameters
    ----------
    time_s : (samples,)
        Even, from zero.
    inputs : (inputs, samples, trials)
    between
        Of each input.
    """

    def __init__(self, time_s: FloatArray, inputs: FloatArray, between: Sequence[Between]) -> None:
        self.step_s = float(time_s[1] - time_s[0])
        self.count, self.samples, self.trials = inputs.shape
        self.inputs = inputs
        self._linear = np.array([kind == "linear" for kind in between], dtype=bool)

    def at(self, t: float, inside: float) -> FloatArray:
        """Return the inputs (inputs, trials) at a time, as seen from `inside`, which tells the side of a jump."""
        u = np.empty((self.count, self.trials))
        for row in range(self.count):
            u[row] = self.signal(row, t, inside)
        return u

    def signal(self, row: int, t: float, inside: float) -> FloatArray:
        """Return one input (trials,); before zero it is its first sample, after the last its last."""
        # a sample's time divided by the step may fall a rounding error short of its number
        k = int(np.floor(inside / self.step_s + 1e-9))
        signal: FloatArray = self.inputs[row]
        if k < 0:
            return np.asarray(signal[0])
        if k >= self.samples - 1:
            return np.asarray(signal[-1])
        if not self._linear[row]:
            return np.asarray(signal[k])
        share = t / self.step_s - k
        return np.asarray((1.0 - share) * signal[k] + share * signal[k + 1])

    def fine(self, row: int, parts: int) -> tuple[float, FloatArray]:
        """Return one input on a grid so many times as fine: its step, and its samples (fine samples, trials)."""
        step_s = self.step_s / parts
        count = (self.samples - 1) * parts + 1
        # a point of the fine grid on a sample is seen from after it
        signal = np.array(
            [self.signal(row, index * step_s, (index + 1e-3) * step_s) for index in range(count)]
        )
        return step_s, signal


_FINE_PARTS = 16
"""Points for each sample of an input that is worked out beforehand."""


@dataclass
class _Parts:
    joints: list[tuple[Hidden, slice]]
    inputs: list[tuple[Hidden, slice, int]]
    outputs: list[tuple[Hidden, slice, int]]
    states: int


class Bench:
    """A plant, its trials, its parameters, and what is hidden.

    `parameters`: of each, a number or one value per trial. `start`, (states, trials): none for the programme's own.
    """

    def __init__(
        self,
        plant: Plant,
        programme: Programme,
        parameters: Mapping[str, FloatArray | float],
        hidden: Sequence[Hidden] = (),
        start: FloatArray | None = None,
    ) -> None:
        self.plant = plant
        self.time_s = programme.time_s
        self.drive = Drive(programme.time_s, programme.inputs, [signal.between for signal in plant.inputs])
        self.trials = len(programme.conditions)
        self.p = plant.values(programme.conditions, parameters)
        self.start = plant.start(programme.conditions) if start is None else start
        self.hidden = tuple(hidden)
        self.parts = self._sort(hidden)
        self.worked_out = {
            row: self._work_out(hidden_part, row)
            for hidden_part, _, row in self.parts.inputs
            if hidden_part.mechanism.prepare
        }
        self.zero = {site.name: np.zeros(self.trials) for site in plant.sites}

    def _sort(self, hidden: Sequence[Hidden]) -> _Parts:
        parts = _Parts([], [], [], 0)
        names = {
            "input": [signal.name for signal in self.plant.inputs],
            "output": [output.name for output in self.plant.outputs],
        }
        for effect in hidden:
            rows = slice(parts.states, parts.states + effect.mechanism.states)
            parts.states = rows.stop
            kind = effect.mechanism.kind
            if kind == "input":
                parts.inputs.append((effect, rows, names[kind].index(effect.mechanism.site)))
            elif kind == "output":
                parts.outputs.append((effect, rows, names[kind].index(effect.mechanism.site)))
            else:
                parts.joints.append((effect, rows))
        return parts

    def _work_out(self, hidden: Hidden, row: int) -> Drive:
        assert hidden.mechanism.prepare is not None
        step_s, signal = self.drive.fine(row, _FINE_PARTS)
        prepared = hidden.mechanism.prepare(hidden.size, step_s, signal)
        return Drive(step_s * np.arange(len(prepared), dtype=np.float64), prepared[None], ["linear"])

    def _drive(self, t: float, inside: float, z: FloatArray, dz: FloatArray) -> FloatArray:
        u = self.drive.at(t, inside)
        plain = u.copy() if self.parts.inputs else u
        for hidden_part, rows, row in self.parts.inputs:
            shift = hidden_part.mechanism.shift_s(hidden_part.size) if hidden_part.mechanism.shift_s else 0.0
            now = self.drive.signal(row, t - shift, inside - shift) if shift else u[row]
            if row in self.worked_out:
                now = self.worked_out[row].signal(0, t, t)
            u[row], dz[rows] = hidden_part.apply(t, z[rows], now, plain)
        return u

    def _forces(
        self, t: float, x: FloatArray, u: FloatArray, z: FloatArray, dz: FloatArray
    ) -> Mapping[str, FloatArray]:
        if not self.parts.joints:
            return self.zero
        force = {name: value.copy() for name, value in self.zero.items()}
        masses: list[tuple[str, FloatArray]] = []
        for joint, rows in self.parts.joints:
            at = self.plant.at(joint.mechanism.site, x, u, self.p)
            f, dz[rows] = joint.apply(t, z[rows], at)
            force[joint.mechanism.site] += f
            if joint.mechanism.mass:
                masses.append((joint.mechanism.site, joint.mechanism.mass(joint.size, at)))
        for site, mass in masses:
            row = self.plant.rate_row(site)
            without = self.plant.rates(x, u, self.p, force)[row]
            pushed = self.plant.rates(x, u, self.p, {**force, site: force[site] + 1.0})[row]
            force[site] -= mass * without / (1.0 + mass * (pushed - without))
        return force

    def _evaluate(
        self, t: float, y: FloatArray, inside: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, Mapping[str, FloatArray]]:
        s = len(self.plant.states)
        x, z = y[:s], y[s:]
        dy = np.zeros_like(y)
        u = self._drive(t, inside, z, dy[s:])
        force = self._forces(t, x, u, z, dy[s:])
        return x, u, dy, force

    def rates(self, t: float, y: FloatArray, inside: float) -> FloatArray:
        """Return the derivative of the plant's and all hidden states (states, trials)."""
        x, u, dy, force = self._evaluate(t, y, inside)
        s = len(self.plant.states)
        if s:
            dy[:s] = self.plant.rates(x, u, self.p, force)
        lagging = [output for output in self.parts.outputs if output[0].mechanism.states]
        if lagging:
            read = self.plant.read(x, u, self.p, force)
            for hidden_part, rows, row in lagging:
                _, dy[s:][rows] = hidden_part.apply(t, y[s:][rows], read[row], read)
        return dy

    def read(self, times: FloatArray, states: Mapping[float, FloatArray]) -> FloatArray:
        """Return the outputs (outputs, samples, trials), as the sensors with all their faults give them."""
        result = np.empty((len(self.plant.outputs), len(times), self.trials))
        for index, t in enumerate(times):
            result[:, index] = self._read_at(float(t), states[round(float(t), 9)])
        plain = result.copy() if self.parts.outputs else result
        s = len(self.plant.states)
        for hidden_part, rows, row in self.parts.outputs:
            shift = hidden_part.mechanism.shift_s(hidden_part.size) if hidden_part.mechanism.shift_s else 0.0
            for index, t in enumerate(times):
                state = states[round(float(t), 9)]
                now = plain[row, index]
                if shift:
                    late = max(float(t) - shift, 0.0)
                    now = self._read_at(late, states[round(late, 9)])[row]
                result[row, index], _ = hidden_part.apply(float(t), state[s:][rows], now, plain[:, index])
        return result

    def _read_at(self, t: float, y: FloatArray) -> FloatArray:
        x, u, _, force = self._evaluate(t, y, t)
        return self.plant.read(x, u, self.p, force)

    def initial(self) -> FloatArray:
        """Return all states at the begin; filters of signals begin at rest on the first value."""
        y = np.concatenate([self.start, np.zeros((self.parts.states, self.trials))])
        s = len(self.plant.states)
        u = self.drive.at(0.0, 0.0)
        for _one, rows, row in self.parts.inputs:
            y[s:][rows] = u[row]
        if any(hidden_part.mechanism.states for hidden_part, _, _ in self.parts.outputs):
            read = self._read_at(0.0, y)
            for _one, rows, row in self.parts.outputs:
                y[s:][rows] = read[row]
        return y

    def corners(self) -> FloatArray:
        """Return every time at which the integration stops: samples, late samples, readings, jumps."""
        end = float(self.time_s[-1])
        times = [self.time_s]
        for effect in self.hidden:
            if effect.mechanism.shift_s:
                way = 1 if effect.mechanism.kind == "input" else -1
                times.append(self.time_s + way * effect.mechanism.shift_s(effect.size))
            times.append(np.array(effect.mechanism.jumps_s, dtype=np.float64))
        joined: FloatArray = np.unique(np.round(np.concatenate(times), 9)).astype(np.float64)
        return joined[(joined >= 0) & (joined <= round(end, 9))]

    def fastest(self) -> float:
        """Return the fastest rate of what is hidden, 1/s."""
        return max([effect.mechanism.fastest(effect.size) for effect in self.hidden], default=0.0)
