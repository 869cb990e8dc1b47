"""Every interval of a trial takes as many of the integrator's steps as what acts there asks for."""

import numpy as np
import pytest

from labrun.effects import Scale, load_effect
from labrun.fit import Dataset, FitTrial, Problem, silent
from labrun.gap.averaging import averaged
from labrun.gap.candidates import Candidate, candidates, site_scales
from labrun.gap.diagnosis import Name
from labrun.gap.recalibration import recalibrate, stated_problem
from labrun.gap.screening import Base, screen_all, survey
from labrun.gap.steps import in_longer_steps, in_shorter_steps, in_steps_that_follow
from labrun.models import Model, parse_model
from labrun.store import SignalInfo

from .benches import CONDITIONS, logged, pendulum, recorded

FAR = 1
"""The condition that reaches the stop."""


@pytest.fixture(scope="module")
def stopped() -> tuple[Problem, np.ndarray]:
    """Return a problem with a hard stop that one of two conditions reaches, and where it stands."""
    problem = _swinging()
    reach = [float(np.max(np.abs(simulated))) for simulated in problem.simulated(problem.priors.stated)]
    assert reach[FAR] > 1.2 * reach[1 - FAR]
    level = 0.5 * sum(reach)
    return _beside(problem, "end-stop", upper=level, lower=-level, stiffness=200.0)


def _swinging() -> Problem:
    model: Model = pendulum()
    return stated_problem(model, averaged(recorded(repeats=1, conditions=CONDITIONS[:2]), model))


def _beside(problem: Problem, effect: str, **sizes: float) -> tuple[Problem, np.ndarray]:
    """Return the problem with an effect of these sizes, and where it stands."""
    candidate = Candidate(Name(effect, "hinge"), load_effect(effect).attach("hinge", **sizes), Scale(), ())
    extended = candidate.added_to(problem)
    free = extended.priors.values[extended.priors.free] / extended.priors.scale
    return extended, np.concatenate([free, problem.own_states(problem.priors.stated)])


def _squares(problem: Problem, z: np.ndarray) -> np.ndarray:
    return np.array([float(residual @ residual) for residual in problem.residuals(z)])


def test_steps_are_shortened_in_the_trials_alone_where_that_changes_anything(stopped) -> None:
    problem, z = stopped
    finer = in_shorter_steps(problem, z, 1e-4 * problem.squares(z))
    assert np.max(finer.steps[FAR]) > np.max(problem.steps[FAR])
    np.testing.assert_array_equal(finer.steps[1 - FAR], problem.steps[1 - FAR])


@pytest.fixture(scope="module")
def rubbing() -> tuple[Problem, np.ndarray]:
    """Return a problem with dry friction that turns sharply, and where it stands."""
    return _beside(_swinging(), "coulomb-friction", torque=1.2e-2, transition_speed=0.03, presliding=0.0)


def test_steps_are_short_near_reversals_alone_where_friction_turns_sharply(rubbing) -> None:
    problem, z = rubbing
    moved = 1e-4 * problem.squares(z)
    mixed = in_shorter_steps(problem, z, moved)
    for counts, before, angle in zip(mixed.steps, problem.steps, mixed.simulated(z), strict=True):
        short = counts > before
        speed = np.abs(np.diff(angle[:, 0]))
        assert 0.0 < np.mean(short) < 0.5
        assert np.mean(speed[short]) < 0.5 * np.mean(speed[~short])


def test_short_steps_in_some_intervals_leave_what_those_in_all_of_them_do(rubbing) -> None:
    problem, z = rubbing
    moved = 1e-4 * problem.squares(z)
    everywhere = problem.with_steps([4 * step for step in problem.steps])
    fine, present = _squares(everywhere, z), _squares(problem, z)
    mixed = in_shorter_steps(problem, z, moved)
    assert abs(np.sum(fine - present)) > moved
    assert abs(np.sum(fine - _squares(mixed, z))) <= moved
    assert sum(len(drive.steps_s) for drive in mixed.drives) < 0.6 * sum(
        len(drive.steps_s) for drive in everywhere.drives
    )


def test_short_steps_only_grow_until_shorter_ones_change_nothing(rubbing) -> None:
    problem, z = rubbing
    moved = 1e-4 * problem.squares(z)
    for _ in range(200):
        finer = in_shorter_steps(problem, z, moved)
        if finer is problem:
            break
        pairs = list(zip(problem.steps, finer.steps, strict=True))
        assert all(np.all(longer <= shorter) for longer, shorter in pairs)
        assert any(np.any(longer < shorter) for longer, shorter in pairs)
        problem = finer
    assert in_shorter_steps(problem, z, moved) is problem


def test_a_beginning_keeps_the_steps_of_its_intervals(rubbing) -> None:
    problem, z = rubbing
    mixed = in_shorter_steps(problem, z, 1e-4 * problem.squares(z))
    beginning, whole = mixed.beginning(0.3), mixed.simulated(z)
    for counts, first, all_counts, outputs in zip(
        beginning.steps, beginning.simulated(z), mixed.steps, whole, strict=True
    ):
        np.testing.assert_array_equal(counts, all_counts[: len(counts)])
        assert first[:-1] == pytest.approx(outputs[: len(first) - 1], abs=1e-12)


def test_steps_that_change_nothing_stay_as_they_are(stopped) -> None:
    problem, z = stopped
    assert in_shorter_steps(problem, z, problem.squares(z)) is problem


def test_steps_are_lengthened_again_in_the_trials_that_do_with_longer_ones(stopped) -> None:
    problem, z = stopped
    finer = problem.with_substeps(16)
    longer = in_longer_steps(finer, z, problem.steps)
    assert np.max(longer.steps[1 - FAR]) < 16


def test_intervals_that_were_shortened_are_lengthened_again_where_nothing_asks_for_them(stopped) -> None:
    problem, z = stopped
    some = [np.where(np.arange(len(counts)) < 50, 4 * counts, counts) for counts in problem.steps]
    longer = in_longer_steps(problem.with_steps(some), z, problem.steps)
    np.testing.assert_array_equal(longer.steps[1 - FAR], problem.steps[1 - FAR])


def test_no_steps_are_longer_than_those_that_are_taken_at_least(stopped) -> None:
    problem, z = stopped
    assert in_longer_steps(problem, z, problem.steps) is problem


SERVO = """
name = "servo"
states = ["angle", "rate"]
inputs = { goal = { unit = "rad", between = "hold" } }
[parameters]
inertia = { value = 0.025, tolerance = 0.05, unit = "kg m^2" }
gain    = { value = 35.0,  tolerance = 0.1, unit = "N m/rad" }
damping = { value = 0.9,   tolerance = "free", unit = "N m s/rad", lower = 0.0 }
[equations]
angle = "rate"
rate  = "(force.joint + gain*(goal - angle) - damping*rate) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.joint]
kind = "joint"
coordinate = "angle"
rate = "rate"
load = "gain*(goal - angle)"
drive = true
[initial]
angle = 0.0
rate = 0.0
"""


def test_a_delay_in_a_loop_is_looked_at_in_steps_that_are_short_beside_it() -> None:
    made = late_servo(0.01)
    model = parse_model(SERVO, "servo.toml")
    recalibrated = recalibrate(model, averaged(made, model), np.random.default_rng(0), silent)
    problem, z = recalibrated.problem, recalibrated.z
    base = Base.of(problem, z)
    (late,) = [
        candidate
        for candidate in candidates(model, site_scales(problem, z), ())
        if candidate.name == Name("loop-delay", "joint")
    ]
    assert survey(base, late).potential > 0.7 * base.squares
    (result,) = screen_all(base, [survey(base, late)])
    assert result.sizes[0] * late.scale.of("time") == pytest.approx(0.01, rel=0.1)
    assert result.gain > 0.98 * base.squares


def test_what_is_slow_beside_the_samples_and_a_parameter_take_the_steps_of_their_base() -> None:
    model = parse_model(SERVO, "servo.toml")
    recalibrated = recalibrate(model, averaged(late_servo(0.01), model), np.random.default_rng(0), silent)
    scales = site_scales(recalibrated.problem, recalibrated.z)
    every = {str(candidate.name): candidate for candidate in candidates(model, scales, ())}
    late, creep = every["loop-delay at joint"], every["viscoelastic-creep at joint"]
    problem = late.added_to(recalibrated.problem)
    z = np.concatenate([recalibrated.z[: recalibrated.problem.size], [0.01 / late.scale.of("time")]])
    base = Base.of(problem, z, (late,))
    for simulated in (every["parameter inertia"], creep):
        assert simulated.pace_s(simulated.starts[0] if simulated.variables else ()) > 3.0 * 0.01
        looked = survey(base, simulated)
        steps = in_steps_that_follow(looked.problem, looked.starts[0], base.residual, np.inf)[0].steps
        assert all(np.array_equal(mine, theirs) for mine, theirs in zip(steps, problem.steps, strict=True))


def late_servo(delay_s: float) -> Dataset:
    """Return steps of a servo, logged every 10 ms, whose controller's torque comes late."""
    rng, trials, step_s = np.random.default_rng(3), [], 5e-4
    for size in (0.2, 0.4, 0.6):
        time_s = np.arange(0.0, 3.0, 0.01)
        goal = size * np.sign(np.sin(2 * np.pi * 0.9 * time_s)) * (time_s > 0.1)
        angle, rate, coming, seen = 0.0, 0.0, [0.0] * round(delay_s / step_s), []
        for aim in goal:
            seen.append(angle)
            for _ in range(round(0.01 / step_s)):
                coming.append(35.5 * (aim - angle))
                torque = coming.pop(0)
                rate += step_s * (torque - 0.85 * rate) / 0.0255
                angle += step_s * rate
        measured = np.array(seen) + 1e-3 * rng.standard_normal(len(seen))
        condition = {"step_rad": size}
        trials.append(FitTrial(f"{size} rad", condition, 1, time_s, goal[:, None], measured[:, None]))
    return logged("servo", SignalInfo("goal", "rad", "hold"), SignalInfo("angle", "rad", "linear"), trials)
