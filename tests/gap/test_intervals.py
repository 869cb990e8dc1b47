"""Intervals of sizes grow with whatever leaves a size open: conditions that disagree, and shapes that are held."""

from dataclasses import replace

import numpy as np
import pytest

from labrun.effects import Scale, load_effect
from labrun.fit import Dataset, OutputNoise
from labrun.gap.averaging import averaged
from labrun.gap.candidates import Candidate
from labrun.gap.diagnosis import Name
from labrun.gap.evidence import Units
from labrun.gap.held_out import mean_residuals
from labrun.gap.intervals import scatter
from labrun.gap.noise import from_repeats, from_residual
from labrun.gap.recalibration import member_residuals, stated_problem
from labrun.gap.screening import Base, refit

from .benches import CONDITIONS, dry_friction, pendulum, recorded

NOISE = 0.004


def with_friction(data: Dataset, *, noise: float = NOISE, shapes: bool = False, rate: float = 2.0) -> Base:
    """Return the pendulum with Coulomb friction, fitted; its sharpness is held, and may be drawn if `shapes`."""
    effect = load_effect("coulomb-friction")
    if not shapes:
        alone = [replace(parameter, starts=parameter.starts[:1]) for parameter in effect.parameters]
        effect = replace(effect, parameters=tuple(alone))
    scale = Scale(coordinate=0.5, rate=rate, acceleration=10.0, force=0.05)
    candidate = Candidate(Name("coulomb-friction", "hinge"), effect.attach("hinge", scale), scale, ((0.1,),))
    units = averaged(data, pendulum())
    problem = candidate.added_to(stated_problem(pendulum(), units))
    problem = problem.with_noise(OutputNoise(np.array([np.sqrt(3.0) / noise])))
    z = refit(problem, problem.begin())
    return Base.of(problem, z, (candidate,))


def spread(base: Base, *, known: bool = True) -> float:
    """Return the standard deviation of the friction's size, N m; `known` is whether repeats tell the noise."""
    problem, z = base.problem, base.z
    members = member_residuals(problem, z)
    noise = from_repeats(problem.data, members) if known else from_residual(problem.data, members)
    assert noise is not None
    units = Units.of(problem.data, mean_residuals(problem, z))
    size = problem.size - 1
    moved = scatter(base, noise, units, np.random.default_rng(2))[:, size]
    return float(np.std(moved) * problem.priors.scale[size])


def size_of(base: Base) -> float:
    """Return the friction, N m."""
    size = base.problem.size - 1
    return float(base.z[size] * base.problem.priors.scale[size])


@pytest.fixture(scope="module")
def same() -> Base:
    return with_friction(recorded(dry_friction(0.006), noise=NOISE))


@pytest.mark.parametrize("known", [True, False])
def test_a_size_that_is_another_one_in_each_condition_is_told_as_that_uncertain(
    same: Base, known: bool
) -> None:
    trials = []
    for index, condition in enumerate(CONDITIONS):
        part = recorded(dry_friction(0.004 if index % 2 else 0.008), noise=NOISE, conditions=[condition])
        trials += part.trials
    apart = with_friction(replace(recorded(), trials=tuple(trials)))
    assert spread(apart, known=known) > 0.0007  # 2 mN m apart, five of them: 0.9 mN m
    assert spread(apart, known=known) > 3.0 * spread(same, known=known)


@pytest.mark.parametrize("known", [True, False])
def test_the_interval_of_a_size_that_noise_alone_made_contains_zero_and_of_one_that_is_real_does_not(
    same: Base, known: bool
) -> None:
    without = with_friction(recorded(noise=NOISE))
    assert size_of(same) > 4.0 * spread(same, known=known)
    assert size_of(without) < 2.0 * spread(without, known=known)
