"""The answer of a transfer function to an input in time, without any error of integration.

The input is straight (or constant) between its samples, so the state moves from sample to sample by a matrix
exponential (Van Loan 1978, *IEEE Trans. Autom. Control* 23:395). The dead time need not be a whole number of samples:
the output between two samples follows from the state at the earlier one by the exponential of the part step.
"""

from typing import Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RequestError

Hold = Literal["linear", "constant"]
_WHOLE = 1e-9
"""A dead time this close to a whole number of samples is one."""


def powers(
    denominator: tuple[float, ...],
    dead_s: float,
    step_s: float,
    values: FloatArray,
    hold: Hold = "linear",
    before: float = 0.0,
) -> FloatArray:
    """Return the answers of ``s^k exp(-dead_s s) / denominator(s)``, k from 0 to its order, shape (n, order + 1).

    Any numerator's answer is their sum, weighted by its coefficients, lowest power first.
    """
    system = StateSpace((1.0,), denominator, step_s)
    whole, part_s = _delay(dead_s, step_s)
    following = values[1:] if hold == "linear" else values[:-1]
    early = system.steady(before)
    states = system.states(values, following, early)
    count = max(len(values) - whole, 0)
    after = np.append(following, values[-1])
    late, held = system.later(states[:count], values[:count], after[:count], part_s)
    answers = np.tile(system.derivatives(early[None], np.array([before])), (len(values), 1))
    answers[whole:] = system.derivatives(late, held)
    return answers


def free_answers(denominator: tuple[float, ...], step_s: float, count: int) -> FloatArray:
    """Return a basis of what the system does by itself from any initial state, (count, order)."""
    system = StateSpace((1.0,), denominator, step_s)
    return system.states(np.zeros(count), np.zeros(count - 1), system.b)


def _delay(dead_s: float, step_s: float) -> tuple[int, float]:
    """Return the whole samples that a dead time reaches back, and the part of a step from there to it."""
    whole = int(np.ceil(dead_s / step_s - _WHOLE))
    part_s = whole * step_s - dead_s
    return whole, part_s if part_s > _WHOLE * step_s else 0.0


def step_response(
    numerator: tuple[float, ...], denominator: tuple[float, ...], dead_s: float, time_s: FloatArray
) -> FloatArray:
    """Return the unit step's answer at any times."""
    from scipy.linalg import expm

    system = StateSpace(numerator, denominator, 1.0)
    after_s = time_s - dead_s
    size = system.size
    if size == 0:
        return np.where(after_s >= 0.0, system.through, 0.0)
    augmented = np.zeros((size + 1, size + 1))
    augmented[:size, :size], augmented[:size, size] = system.a, system.b
    late = np.maximum(after_s, 0.0)
    moved = expm(augmented * np.atleast_1d(late)[..., None, None])
    values = (moved[..., :size, size] @ system.c + system.through).reshape(after_s.shape)
    return np.where(after_s >= 0.0, values, 0.0)


class StateSpace:
    """Controller canonical form with time in units of its own speed, so that its matrix is well scaled."""

    def __init__(self, numerator: tuple[float, ...], denominator: tuple[float, ...], step_s: float) -> None:
        size = len(denominator) - 1
        lead = denominator[0]
        below = np.array(denominator[1:]) / lead
        above = np.concatenate([np.zeros(size + 1 - len(numerator)), numerator]) / lead
        self.size = size
        self.step_s = step_s
        self.through = float(above[0])
        self.lead = lead
        # each state in units of speed^k: the companion matrix of poles near the unit circle
        powers = np.arange(1.0, size + 1)
        speed = float(np.max(np.abs(below) ** (1.0 / powers))) if size and np.any(below) else 1.0
        self.a = np.zeros((size, size))
        self.b = np.zeros(size)
        self.c = np.zeros(size)
        if size:
            self.a[0] = -below / speed ** (powers - 1)
            self.a[range(1, size), range(size - 1)] = speed
            self.b[0] = speed
            self.c = (above[1:] - below * self.through) / speed**powers
        self.speeds = speed**powers

    def derivatives(self, states: FloatArray, values: FloatArray) -> FloatArray:
        """Return the answers of s^k/denominator, k rising from 0, of states and input at the same times."""
        # the first state's rate, in its own units, is the answer of s^n
        highest = (states @ self.a[0] + self.b[0] * values) / self.b[0] if self.size else values
        return np.column_stack([(states / self.speeds)[:, ::-1], highest]) / self.lead

    def steady(self, value: float) -> FloatArray:
        """Return the state that a constant input has led to."""
        if value == 0.0 or self.size == 0:
            return np.zeros(self.size)
        try:
            return np.asarray(np.linalg.solve(self.a, -self.b * value))
        except np.linalg.LinAlgError:
            raise RequestError(
                "a transfer function with a pole at zero has no steady state under a constant input",
                hint="start it from input 0",
            ) from None

    def matrices(self, step_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the state's move over a step: by itself, by the input, by how much the input grows over it."""
        from scipy.linalg import expm

        size = self.size
        augmented = np.zeros((size + 2, size + 2))
        augmented[:size, :size], augmented[:size, size] = self.a * step_s, self.b * step_s
        augmented[size, size + 1] = 1.0
        moved = expm(augmented)
        return moved[:size, :size], moved[:size, size], moved[:size, size + 1]

    def states(self, values: FloatArray, following: FloatArray, start: FloatArray) -> FloatArray:
        """Return the state at every sample, (n, size).

        The recursion runs in the basis of a Schur form, where each state is a filter of first order on those after it:
        as exact with equal poles as with different ones.
        """
        from scipy.linalg import schur
        from scipy.signal import lfilter

        if self.size == 0:
            return np.zeros((len(values), 0))
        move, by_input, by_growth = self.matrices(self.step_s)
        triangle, basis = schur(move, output="complex")
        drive = np.outer(values[:-1], by_input) + np.outer(following - values[:-1], by_growth)
        turned = drive @ basis.conj()
        first = basis.conj().T @ start
        found = np.empty((len(values), self.size), dtype=complex)
        for row in range(self.size - 1, -1, -1):
            pushed = turned[:, row] + found[:-1, row + 1 :] @ triangle[row, row + 1 :]
            pole = triangle[row, row]
            found[0, row] = first[row]
            found[1:, row] = lfilter([1.0], [1.0, -pole], pushed, zi=[pole * first[row]])[0]
        return np.asarray((found @ basis.T).real)

    def later(
        self, states: FloatArray, values: FloatArray, following: FloatArray, part_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return state and input `part_s` after each sample."""
        growth = (following - values) * (part_s / self.step_s)
        if not self.size:
            return states, values + growth
        move, by_input, by_growth = self.matrices(part_s)
        return states @ move.T + np.outer(values, by_input) + np.outer(growth, by_growth), values + growth
