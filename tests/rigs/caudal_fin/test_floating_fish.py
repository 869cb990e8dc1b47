"""The floating fish: which tails move it, and which turn it."""

import numpy as np
import pytest
from labrun_plugins.rigs.caudal_fin.floating_scene import FloatingFish
from scipy.integrate import solve_ivp

from labrun.devices import Trajectory
from labrun.errors import ExperimentError
from labrun.experiment import shipped_experiments
from labrun.store import read_recording

TABLE = read_recording(shipped_experiments() / "recordings" / "table-5-2").trials


def beating(seed=0, amplitude_deg=60.0, duration_s=10.0, **settings):
    fish = FloatingFish(settings, np.random.default_rng(seed))
    fish.observe(["x"], np.array([0.0]))
    time_s = np.arange(0.0, duration_s, 0.01)
    angle = np.radians(amplitude_deg * np.sin(2 * np.pi * 1.4 * time_s))
    fish.drive("tail", Trajectory(("tail",), time_s, angle[:, None]), 0.5)
    return fish, fish.observe(["x", "ahead", "heading", "tail"], 0.5 + time_s)


@pytest.mark.parametrize("trial", TABLE, ids=lambda trial: str(trial.condition))
def test_the_fish_swims_with_the_tails_of_the_table_that_swim(trial):
    swims = trial.outputs[0, 1]
    for seed in range(3):
        fish, _ = beating(seed, **trial.condition)
        assert fish.answer("swims") == ("yes" if swims else "no")


def test_the_body_turns_against_its_tail_farther_the_stiffer_it_is():
    turned = [np.ptp(beating(noise=0, thickness_mm=mm)[1][:, 2]) for mm in (0.254, 0.508, 1.016, 1.524)]
    assert turned == sorted(turned)
    _, seen = beating(noise=0)
    assert np.corrcoef(seen[:, 2], seen[:, 3])[0, 1] == pytest.approx(-1.0)


def test_it_speeds_up_as_thrust_and_quadratic_drag_have_it():
    fish, seen = beating(noise=0, duration_s=20.0)
    named = fish.truth()["parameters"]
    thrust_n = named["drag"] * seen[-200:, 1].mean() ** 2
    start = 400
    exact = solve_ivp(
        lambda _, v: (thrust_n - named["drag"] * v * abs(v)) / named["mass"],
        (0.0, 10.0),
        [seen[start, 1]],
        rtol=1e-8,
    ).y[0, -1]
    assert seen[start + 1000, 1] == pytest.approx(exact, rel=0.02)


def test_it_is_put_back_at_rest_with_the_tail_of_the_condition():
    fish, seen = beating()
    assert seen[-1, 0] > 0.3
    fish.arrange({"thickness_mm": 0.254})
    np.testing.assert_allclose(fish.observe(["x"], np.array([10.51]))[0, 0], 0.0, atol=1e-3)
    assert fish.truth()["fin"] == {"material": "polyester", "thickness_mm": 0.254, "fin": "large"}


def test_a_restored_fish_goes_on_to_the_same_place():
    fish, _ = beating()
    stored = fish.snapshot()
    after_s = np.arange(10.5, 12.0, 0.01)
    expected = fish.observe(["x", "ahead"], after_s)
    other = FloatingFish({}, np.random.default_rng(9))
    other.restore(stored)
    np.testing.assert_array_equal(other.observe(["x", "ahead"], after_s), expected)


def test_a_question_that_nobody_can_answer_from_looking_is_refused():
    fish, _ = beating()
    with pytest.raises(ExperimentError, match="nobody can read 'colour'"):
        fish.answer("colour")
