"""Where a linkage in MuJoCo begins: positions at which its loops are closed or at rest, and rates that fit them.

Loops are the equality constraints ``connect`` and ``weld``. Closing them is a least-squares problem: shortest Newton
steps where they are nearly closed, else a trust region. Rest is the least potential energy along the loops: Newton's
method in the null space of the constraints (Nocedal & Wright, Numerical Optimization, 2nd ed. 2006, section 18.1), with
negative curvature turned round so that no unstable balance holds it.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import least_squares

from labrun.arrays import FloatArray, IntArray
from labrun.errors import ModelError
from labrun.models.mjcf.plant import imported, loop_kinds

CLOSED = 1e-9
"""A loop is closed within this: m, and for the rotation of a weld its part of a quaternion."""
_EXACT = 1e-13
_STILL = 1e-10
"""Joints are at rest when Newton would move them by no more, rad or m."""
_MOST_STEPS = 200
_FEW_STEPS = 12
_LONGEST_STEP = 0.2
_DIFFERENCE = 1e-6
_DEPENDENT = 1e-8
"""Share of the largest singular value below which a condition depends on others."""


class Linkage:
    """A simulation in MuJoCo whose joints are moved until its loops close; `name` is for messages."""

    def __init__(self, model: Any, data: Any, name: str) -> None:
        self._mujoco = imported()
        self._model, self._data, self._name = model, data, name

    def close(self, moving: IntArray) -> None:
        """Move these degrees of freedom, as little as it takes, until all loops are closed.

        Raises
        ------
        ModelError
            A loop stays open.
        """
        start = self._data.qpos.copy()
        step = self._shortest_steps(moving)
        if step is None:  # far away: with a trust region

            def apart_at(moved: FloatArray) -> FloatArray:
                return self._loops_at(start, moving, moved)[0]

            def jacobian_at(moved: FloatArray) -> FloatArray:
                return self._loops_at(start, moving, moved)[1][:, moving]

            step = least_squares(
                apart_at, np.zeros(len(moving)), jacobian_at,
                xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=_MOST_STEPS,
            ).x  # fmt: skip
        apart, _ = self._loops_at(start, moving, step)
        if not np.max(np.abs(apart), initial=0.0) < CLOSED:
            raise self._stays_open(apart, moving)

    def _shortest_steps(self, moving: IntArray) -> FloatArray | None:
        """Return how shortest Newton steps close loops that are nearly closed; None where they do not, or are long."""
        start, moved = self._data.qpos.copy(), np.zeros(len(moving))
        apart, jacobian = self._loops()
        for _ in range(_FEW_STEPS):
            if np.max(np.abs(apart), initial=0.0) < _EXACT:
                break
            step = np.linalg.lstsq(jacobian[:, moving], -apart, rcond=_DEPENDENT)[0]
            nearer, jacobian = self._loops_at(start, moving, moved + step)
            if not np.linalg.norm(nearer) < np.linalg.norm(
                apart
            ):  # as exact as rounding lets it be, or astray
                break
            if np.max(np.abs(step), initial=0.0) > _LONGEST_STEP:
                return None
            apart, moved = nearer, moved + step
        return moved if np.max(np.abs(apart), initial=0.0) < CLOSED else None

    def _loops_at(
        self, start: FloatArray, moving: IntArray, moved: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return what `_loops` does, with some degrees of freedom moved from a start."""
        step = np.zeros(self._model.nv)
        step[moving] = moved
        self._data.qpos[:] = start
        self._move(step)
        return self._loops()

    def settle(self, resting: IntArray) -> None:
        """Move these degrees of freedom to the nearest stable balance of springs and weights with closed loops.

        Raises
        ------
        ModelError
            A loop stays open, or there is no such balance.
        """
        self._data.qvel[:] = 0.0
        for _ in range(_MOST_STEPS):
            _, jacobian = self._loops()
            free = null_space(jacobian[:, resting], rcond=_DEPENDENT)
            push = self._data.qfrc_smooth[resting].copy()
            multipliers = np.linalg.lstsq(jacobian[:, resting].T, -push, rcond=_DEPENDENT)[0]
            curvature, axes = np.linalg.eigh(free.T @ self._hessian(resting, multipliers) @ free)
            if not np.isfinite(curvature).all() or not np.all(np.abs(curvature) > 0):
                break
            step = np.zeros(self._model.nv)
            step[resting] = free @ (axes @ ((axes.T @ (free.T @ push)) / np.abs(curvature)))
            if np.max(np.abs(step), initial=0.0) < _STILL and np.all(curvature > 0):
                return
            self._move(_limited(step))
            self.close(resting)
        raise ModelError(
            f"model {self._name} has no stable rest near where its search begins",
            hint="give the MJCF file a keyframe nearer to the rest, or the joints stiffness",
        )

    def fit_rates(self) -> None:
        """Make the rates fit the loops, with the least change of kinetic energy."""
        if not np.any(self._data.qvel):
            return
        _, jacobian = self._loops()
        answer = np.zeros_like(jacobian)
        self._mujoco.mj_solveM(self._model, self._data, answer, jacobian)
        pulls = np.linalg.lstsq(jacobian @ answer.T, jacobian @ self._data.qvel, rcond=_DEPENDENT)[0]
        self._data.qvel[:] -= answer.T @ pulls

    def _move(self, step: FloatArray) -> None:
        self._mujoco.mj_integratePos(self._model, self._data.qpos, step, 1.0)

    def _loops(self) -> tuple[FloatArray, FloatArray]:
        """Return how far the loops are open, and its derivative by all degrees of freedom."""
        model, data = self._model, self._data
        self._mujoco.mj_forward(model, data)
        equalities = data.efc_type == int(self._mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        rows = np.flatnonzero(equalities)
        rows = rows[np.isin(model.eq_type[data.efc_id[rows]], loop_kinds())]
        jacobian, column = np.empty((len(rows), model.nv)), np.empty(data.nefc)
        for dof in range(model.nv):
            self._mujoco.mj_mulJacVec(model, data, column, np.eye(model.nv)[dof])
            jacobian[:, dof] = column[rows]
        return data.efc_pos[rows].copy(), jacobian

    def _hessian(self, resting: IntArray, multipliers: FloatArray) -> FloatArray:
        """Return the second derivative of energy and constraint by the resting joints, by central differences."""
        here = self._data.qpos.copy()

        def pull(step: FloatArray) -> FloatArray:
            self._data.qpos[:] = here
            self._move(step)
            _, jacobian = self._loops()
            return np.asarray(-(jacobian.T @ multipliers + self._data.qfrc_smooth)[resting])

        columns = _differences(pull, np.eye(self._model.nv)[resting])
        self._data.qpos[:] = here
        self._loops()
        return 0.5 * (columns + columns.T)

    def _stays_open(self, apart: FloatArray, moving: IntArray) -> ModelError:
        held = np.setdiff1d(np.arange(self._model.nv), moving)
        names = [self._model.joint(int(self._model.dof_jntid[dof])).name for dof in held]
        kept = ", ".join(dict.fromkeys(name for name in names if name))
        return ModelError(
            f"the loops of model {self._name} do not close: they stay {np.max(np.abs(apart)):.3g} m apart",
            hint=f"{kept} {'are' if len(names) > 1 else 'is'} held by [initial]; choose another value, or leave it out"
            if kept
            else "see whether the bodies of its connect and weld constraints can meet, and begin nearer to it",
        )


def _limited(step: FloatArray) -> FloatArray:
    return step * min(1.0, _LONGEST_STEP / max(float(np.max(np.abs(step), initial=0.0)), 1e-300))


def _differences(function: Callable[[FloatArray], FloatArray], directions: FloatArray) -> FloatArray:
    """Return the derivative of a function along each direction, shape (values, directions)."""
    columns = [
        (function(_DIFFERENCE * direction) - function(-_DIFFERENCE * direction)) / (2 * _DIFFERENCE)
        for direction in directions
    ]
    return np.array(columns).T
