import numpy as np
import pytest
from cma.recombination_weights import RecombinationWeights
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.search.strategy import Constants, Strategy


def make(seed=0, n=6, population=60, parents=30):
    return Strategy(np.full(n, 0.5), 0.3, population, parents, np.random.default_rng(seed))


def test_population_60_with_30_parents_and_6_variables_gives_the_constants_of_table_6_1():
    in_force = make().constants  # as pycma's own objects hold them
    assert in_force.mu_eff == pytest.approx(16.57, abs=0.01)
    assert in_force.d_sigma == pytest.approx(2.66, abs=0.005)
    assert in_force.c_mu == pytest.approx(0.36, abs=0.005)
    assert in_force.c_sigma == pytest.approx(0.67, abs=0.005)


def test_the_constants_of_table_6_1_follow_from_the_formulas_by_hand():
    weights = np.log(30.5) - np.log(np.arange(1, 31))
    weights /= weights.sum()
    mu_eff = 1 / (weights**2).sum()
    assert mu_eff == pytest.approx(16.5757, abs=1e-4)
    assert (mu_eff + 2) / (6 + mu_eff + 5) == pytest.approx(0.6736, abs=1e-4)
    assert 1 + 2 * (np.sqrt((mu_eff - 1) / 7) - 1) + 0.6736 == pytest.approx(2.657, abs=1e-3)
    assert 2 * (mu_eff - 2 + 1 / mu_eff) / (64 + mu_eff) == pytest.approx(0.3633, abs=1e-4)
    hand = Constants.of(6, 60, float(mu_eff))
    in_force = make().constants
    for name in Constants.__slots__:
        assert getattr(in_force, name) == pytest.approx(getattr(hand, name), rel=1e-9), name


@given(n=st.integers(2, 20), parents=st.integers(2, 40))
@settings(max_examples=25, deadline=None)
def test_the_constants_in_force_are_those_of_the_formulas_for_any_size(n, parents):
    in_force = make(n=n, population=2 * parents, parents=parents).constants
    hand = Constants.of(n, 2 * parents, float(RecombinationWeights(2 * parents).mueff))
    assert in_force.c_mu == pytest.approx(hand.c_mu, rel=1e-9)
    assert in_force.c_1 == pytest.approx(hand.c_1, rel=1e-9)
    assert in_force.d_sigma == pytest.approx(hand.d_sigma)


def sphere(points):
    return [float(((point - 0.3) ** 2).sum()) for point in points]


def test_the_constants_stay_in_force_while_the_search_goes_on():
    strategy = make()
    before = strategy.constants
    for _ in range(5):
        points = strategy.ask(60)
        strategy.tell(points, sphere(points))
    assert strategy.constants == before


def test_all_points_stay_inside_the_unit_cube():
    strategy = Strategy(np.array([0.02, 0.98]), 0.6, 20, None, np.random.default_rng(1))
    for _ in range(20):
        points = strategy.ask(20)
        assert all(((point >= 0) & (point <= 1)).all() for point in points)
        strategy.tell(points, [float(point.sum()) for point in points])
    assert ((strategy.mean >= 0) & (strategy.mean <= 1)).all()


def test_randomness_comes_from_the_given_generator_alone():
    runs = []
    for disturbance in (1, 2):
        np.random.seed(disturbance)  # noqa: NPY002
        strategy = make(seed=7)
        for _ in range(4):
            points = strategy.ask(60)
            strategy.tell(points, sphere(points))
        runs.append(strategy.state())
        after = np.random.rand()  # noqa: NPY002
        np.random.seed(disturbance)  # noqa: NPY002
        assert after == np.random.rand()  # noqa: NPY002
    assert runs[0] == runs[1]


def test_leaders_told_again_do_not_hinder_convergence():
    strategy = make(population=20, parents=10, n=4)
    leaders = []
    for _ in range(40):
        points = [*leaders, *strategy.ask(20 - len(leaders))]
        costs = sphere(points)
        strategy.tell(points, costs, known=len(leaders))
        leaders = [points[i] for i in np.argsort(costs)[:3]]
    assert sphere([strategy.mean])[0] < 1e-8
