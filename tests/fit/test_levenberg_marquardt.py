"""The descent finds what scipy's general solver finds, at a cost that grows with the number of trials only."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from test_output_error import driven, oscillator

from labrun.fit.dataset import Dataset, FitTrial, SignalInfo
from labrun.fit.levenberg_marquardt import NormalEquations, minimise
from labrun.fit.problem import Problem
from labrun.fit.simulations import workers
from labrun.models import Model, parse_model, simulate

FloatArray = NDArray[np.float64]


def problem_and_start(model: Model, trials: int = 4) -> tuple[Problem, FloatArray]:
    problem = Problem.of(
        model, driven(np.random.default_rng(1), trials, noise=0.01, scatter=0.05, duration_s=2.0)
    )
    return problem, problem.begin()


def whole(problem: Problem, z: FloatArray) -> FloatArray:
    return np.concatenate([*problem.residuals(z), problem.priors.residual(z)])


@pytest.mark.parametrize("tolerances", [{}, {"mass": 0.05}, {"stiffness": 0.02}])
def test_it_ends_where_scipys_trust_region_ends(tolerances: dict[str, float | str]) -> None:
    problem, z = problem_and_start(oscillator(**tolerances))
    ours = minimise(problem, z)
    theirs = least_squares(lambda x: whole(problem, x), z, x_scale="jac", ftol=1e-12, xtol=1e-12)
    np.testing.assert_allclose(ours, theirs.x, rtol=1e-4, atol=1e-6)
    assert np.sum(whole(problem, ours) ** 2) == pytest.approx(2 * theirs.cost, rel=1e-7)


def test_a_bound_holds_where_scipys_holds() -> None:
    problem, z = problem_and_start(oscillator())
    upper = np.array([35.0, np.inf]) / problem.priors.scale
    ours = minimise(problem, z, upper=upper)
    limits = np.concatenate([upper, np.full(len(z) - 2, np.inf)])
    theirs = least_squares(
        lambda x: whole(problem, x), z, bounds=(-np.inf, limits), x_scale="jac", ftol=1e-12, xtol=1e-12
    )
    assert ours[0] == upper[0]
    np.testing.assert_allclose(ours, theirs.x, rtol=1e-3, atol=1e-4)


JOINT = """
name = "joint"
states = ["angle", "rate"]
inputs = ["torque"]
[parameters]
inertia   = { value = 0.018, tolerance = "free", unit = "kg m^2" }
damping   = { value = 0.028, tolerance = "free", unit = "N m s/rad" }
stiffness = { value = 0.72, tolerance = "free", unit = "N m/rad" }
gravity   = { value = 0.32, tolerance = "free", unit = "N m" }
[equations]
angle = "rate"
rate  = "(torque - stiffness*angle - damping*rate - gravity*sin(angle)) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[initial]
angle = 0.0
rate = 0.0
"""


@pytest.mark.parametrize("seed", range(6))
def test_it_goes_on_where_bounds_cut_a_step_of_parameters_that_stand_in_for_each_other(seed: int) -> None:
    """Stiffness and gravity are nearly one; the true values lie outside what the bounds allow."""
    rng = np.random.default_rng(seed)
    model = parse_model(JOINT, "joint.toml")
    time_s = np.arange(0.0, 4.0, 0.02)
    trials = []
    for index in range(3):
        torque = (0.3 + 0.2 * index) * np.sin(2 * np.pi * (0.4 + 0.5 * index) * time_s)[:, None]
        true = {"inertia": 0.018, "damping": 0.09, "stiffness": 0.9, "gravity": 0.33}
        outputs = simulate(model, time_s, torque, parameters=true).outputs
        trials.append(FitTrial(f"trial {index}", {}, index + 1, time_s, torque, outputs))
    inputs, outputs = (SignalInfo("torque", "N m"),), (SignalInfo("angle", "rad"),)
    problem = Problem.of(model, Dataset("joint", Path("joint"), "recording", inputs, outputs, tuple(trials)))
    stated = problem.priors.values / problem.priors.scale
    lower, upper = 0.85 * stated, 1.15 * stated
    z = stated * rng.choice([0.85, 1.0, 1.15], size=4)
    ours = minimise(problem, z, lower=lower, upper=upper)
    inside = np.clip(z, lower + 1e-6, upper - 1e-6)
    theirs = least_squares(lambda x: whole(problem, x), inside, bounds=(lower, upper), ftol=1e-12, xtol=1e-12)
    assert np.sum(whole(problem, ours) ** 2) == pytest.approx(2 * theirs.cost, rel=1e-3)


def test_the_eliminated_step_is_the_step_of_the_whole_system() -> None:
    problem, z = problem_and_start(oscillator(mass=0.1))
    blocks = problem.jacobian(z)
    equations = NormalEquations.of(problem, z, blocks)
    rows = [len(part) for part in blocks.residual]
    jacobian = np.zeros((sum(rows) + problem.size, len(z)))
    row = 0
    for trial, count in enumerate(rows):
        own = problem.size + trial * problem.own_size
        jacobian[row : row + count, : problem.size] = blocks.shared[trial]
        jacobian[row : row + count, own : own + problem.own_size] = blocks.own[trial]
        row += count
    jacobian[row:, : problem.size] = np.diag(-problem.priors.scale / problem.priors.pull)
    residual = whole(problem, z)
    damping = 1e-3 * np.sum(jacobian**2, axis=0)
    expected = -np.linalg.solve(jacobian.T @ jacobian + np.diag(damping), jacobian.T @ residual)
    step = equations.step(damping)
    np.testing.assert_allclose(step, expected, rtol=1e-6)
    fall = residual @ residual - np.sum((residual + jacobian @ step) ** 2)
    assert equations.gain(step) == pytest.approx(fall, rel=1e-6)
    np.testing.assert_allclose(equations.diagonal, np.sum(jacobian**2, axis=0))


def test_a_parameter_without_room_stays_where_it_is() -> None:
    problem, z = problem_and_start(oscillator(), trials=2)
    equations = NormalEquations.of(problem, z, problem.jacobian(z))
    room = np.array([0.0, -np.inf]), np.array([0.0, np.inf])
    assert equations.step(1e-3 * equations.diagonal, room)[0] == 0.0


@pytest.mark.parametrize("tolerances", [{}, {"mass": 0.05}])
def test_derivatives_carried_on_from_step_to_step_lead_to_the_same_end(
    tolerances: dict[str, float | str],
) -> None:
    problem, z = problem_and_start(oscillator(**tolerances))
    plain, carried = minimise(problem, z), minimise(problem, z, secant=True)
    np.testing.assert_allclose(carried, plain, rtol=1e-6, atol=1e-8)


def test_derivatives_known_from_nearby_save_most_of_the_simulations() -> None:
    problem, z = problem_and_start(oscillator())
    end = minimise(problem, z)
    near = end * (1.0 + 0.01 * np.sign(end))
    known = problem.jacobian(end)
    begun_at = problem.simulations.made
    plain = minimise(problem, near, tolerance=1e-4)
    spent = problem.simulations.made - begun_at
    chord = minimise(problem, near, tolerance=1e-4, derivatives=known, secant=True, confirmed=False)
    assert problem.simulations.made - begun_at - spent < 0.4 * spent
    squares = [np.sum(whole(problem, start) ** 2) for start in (plain, chord)]
    assert squares[1] == pytest.approx(squares[0], rel=1e-3)


def test_derivatives_that_mislead_are_taken_anew() -> None:
    problem, z = problem_and_start(oscillator())
    wrong = problem.jacobian(z)
    backwards = [-derivatives for derivatives in wrong.shared], [-derivatives for derivatives in wrong.own]
    misled = minimise(problem, z, derivatives=replace(wrong, shared=backwards[0], own=backwards[1]))
    np.testing.assert_allclose(misled, minimise(problem, z), rtol=1e-6, atol=1e-8)


def test_variables_that_do_not_move_are_not_differentiated() -> None:
    problem, z = problem_and_start(oscillator(), trials=2)
    blocks = problem.jacobian(z, moving=np.array([False, True]))
    every = problem.jacobian(z)
    for shared, whole_block in zip(blocks.shared, every.shared, strict=True):
        assert not shared[:, 0].any()
        np.testing.assert_array_equal(shared[:, 1], whole_block[:, 1])


def test_a_descent_ends_where_it_would_take_derivatives_more_often_than_it_may() -> None:
    problem, z = problem_and_start(oscillator())
    right = problem.jacobian(z)
    backwards = replace(
        right,
        shared=[-derivatives for derivatives in right.shared],
        own=[-derivatives for derivatives in right.own],
    )
    np.testing.assert_array_equal(minimise(problem, z, derivatives=backwards, renewals=0), z)
    once = minimise(problem, z, derivatives=backwards, secant=True, renewals=1)
    assert problem.squares(once) < 0.5 * problem.squares(z)


class RoughProblem(Problem):
    """Simulations that jump from point to point, as a dry friction's do in steps of the integrator."""

    def trial_residual(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray | None:
        smooth = super().trial_residual(parameters, trial, own)
        return None if smooth is None else smooth + 1e-3 * np.sin(1e9 * np.sum(parameters))


def test_a_descent_on_rough_ground_ends_where_no_step_promises_what_counts() -> None:
    smooth, z = problem_and_start(oscillator())
    near = minimise(smooth, z) * 1.01
    rough = RoughProblem.of(smooth.model, smooth.data)
    residual = rough.residuals(near)
    begun_at = rough.simulations.made
    end = minimise(
        rough,
        near,
        tolerance=1e-2,
        derivatives=smooth.jacobian(near),
        confirmed=False,
        residual=residual,
    )
    assert rough.squares(end) == pytest.approx(smooth.squares(minimise(smooth, z)), rel=0.01)
    # a step down, derivatives that tell of jumps alone, a step that gains nothing: not one shorter step after the other
    spent = (rough.simulations.made - begun_at) / len(rough.data.trials)
    assert spent <= 3 + 2 * len(near[: rough.size]) + 2 * rough.own_size


def test_trials_simulated_side_by_side_give_the_same_to_the_last_bit() -> None:
    problem, z = problem_and_start(oscillator())
    with workers(3) as each:
        together = replace(problem, each=each)
        np.testing.assert_array_equal(minimise(together, z), minimise(problem, z))
