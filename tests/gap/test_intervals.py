"""Intervals of sizes grow with whatever leaves a size open: conditions that disagree, and shapes that are held."""

from dataclasses import replace

import numpy as np
import pytest

from labrun.effects import Scale, load_effect
from labrun.fit import Dataset, OutputNoise
from labrun.gap.averaging import averaged
from labrun.gap.candidates import Candidate
from labrun.gap.diagnosis import Name
from labrun.gap.intervals import may_be_nothing, scatter
from labrun.gap.recalibration import stated_problem
from labrun.gap.screening import Base, refit

from .benches import CONDITIONS, FloatArray, dry_friction, pendulum, recorded

NOISE = 0.004


def with_friction(data: Dataset, *, noise: float = NOISE, shapes: bool = False, rate: float = 2.0) -> Base:
    """Return the pendulum with Coulomb friction, fitted; its sharpness is held, and may be drawn if `shapes`."""
    effect = load_effect("coulomb-friction")
    if not shapes:
        alone = [replace(one, starts=one.starts[:1]) for one in effect.parameters]
        effect = replace(effect, parameters=tuple(alone))
    scale = Scale(coordinate=0.5, rate=rate, acceleration=10.0, force=0.05)
    candidate = Candidate(Name("coulomb-friction", "hinge"), effect.attach("hinge", scale), scale, ((0.1,),))
    units = averaged(data, pendulum())
    problem = candidate.added_to(stated_problem(pendulum(), units))
    problem = problem.with_noise(OutputNoise(np.array([np.sqrt(3.0) / noise])))
    z = refit(problem, problem.begin())
    return Base.of(problem, z, (candidate,))


def spread(base: Base, noise: float = 1.0) -> float:
    """Return the standard deviation of the friction's size, white noise being drawn."""
    rng = np.random.default_rng(2)
    draws = [[noise * rng.standard_normal(one.shape) for one in base.residual] for _ in range(400)]
    return float(np.std(scatter(base, draws)[:, base.problem.size - 1]))


@pytest.fixture(scope="module")
def same() -> Base:
    return with_friction(recorded(dry_friction(0.006), noise=NOISE))


def test_a_size_that_is_another_one_in_each_condition_is_told_as_that_uncertain(same: Base) -> None:
    trials = []
    for place, condition in enumerate(CONDITIONS):
        part = recorded(dry_friction(0.004 if place % 2 else 0.008), noise=NOISE, conditions=[condition])
        trials += part.trials
    apart = with_friction(replace(recorded(), trials=tuple(trials)))
    size = apart.problem.size - 1
    scale: FloatArray = apart.problem.priors.scale
    assert spread(apart) * scale[size] > 0.0007  # 2 mN m apart, five of them: 0.9 mN m
    assert spread(apart) > 5.0 * spread(same)


def test_a_shape_that_is_held_leaves_its_size_as_open_as_the_data_do() -> None:
    noisy = recorded(dry_friction(0.006), noise=0.1)
    held, drawn = (with_friction(noisy, noise=0.1, rate=20.0, shapes=shapes) for shapes in (False, True))
    assert spread(drawn, noise=0.0) > 1.3 * spread(held, noise=0.0)


def test_a_size_that_noise_alone_would_make_may_be_nothing_and_one_that_is_there_may_not(same: Base) -> None:
    without = with_friction(recorded(noise=NOISE))
    for base, nothing in ((same, False), (without, True)):
        rng = np.random.default_rng(3)
        draws = [[rng.standard_normal(one.shape) for one in base.residual] for _ in range(200)]
        assert (Name("coulomb-friction", "hinge") in may_be_nothing(base, scatter(base, draws))) is nothing
