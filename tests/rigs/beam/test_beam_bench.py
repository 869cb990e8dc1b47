"""The beam bench: three straight pieces of force over displacement, a small loop, and what a person changes."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.rigs.beam.scene import LIMITS_N_M, STIFFNESS_N_M, BeamBench
from scipy.integrate import solve_ivp

from labrun import registry
from labrun.devices import Trajectory
from labrun.errors import SpecError

LEVER_M = 0.1


def bench(seed=0, **keys):
    return BeamBench({"noise": 0, **keys}, np.random.default_rng(seed))


def path(points_m, times_s):
    return Trajectory(("pusher",), np.array(times_s, dtype=float), np.array(points_m, dtype=float)[:, None])


def pushed(made, points_m, times_s, time_s):
    made.observe(("force",), np.zeros(1))
    made.drive("pusher", path(points_m, times_s), 1.0)
    return made.observe(("force", "position", "bend"), 1.0 + np.asarray(time_s))


def still_force(beam, displacement_m):
    """Return the force of the three straight pieces, from the numbers of the source, written down once more."""
    equal, opposite = LIMITS_N_M[beam]
    stiff, soft = STIFFNESS_N_M[beam], 0.05 * STIFFNESS_N_M[beam]
    angle = displacement_m / LEVER_M
    if angle < -equal / stiff:
        return (-equal + soft * (angle + equal / stiff)) / LEVER_M
    if angle > opposite / stiff:
        return (opposite + soft * (angle - opposite / stiff)) / LEVER_M
    return stiff * angle / LEVER_M


@pytest.mark.parametrize("beam", ["long", "short"])
@settings(max_examples=15, deadline=None)
@given(to_m=st.floats(-0.045, 0.045))
def test_at_rest_the_force_is_that_of_three_straight_pieces(beam, to_m):
    force = pushed(bench(hysteresis=0.0, after_share=1.0, beam=beam), [0.0, to_m], [0.0, 5.0], [6.0])[0, 0]
    assert force == pytest.approx(still_force(beam, to_m), abs=1e-9)


def test_it_buckles_at_the_sources_torque_in_equal_sense_and_not_in_opposite_sense():
    time_s = np.arange(0.0, 50.0, 0.1)
    made = bench(hysteresis=0.0)
    equal = -pushed(made, [0.0, -0.025], [0.0, 50.0], time_s)[:, 0] * LEVER_M
    opposite = pushed(bench(hysteresis=0.0), [0.0, 0.025], [0.0, 50.0], time_s)[:, 0] * LEVER_M
    way_rad = 0.025 / 50.0 * time_s / LEVER_M
    before, after = way_rad < 0.04, way_rad > 0.06
    for torque in (equal[before], opposite[before]):
        assert np.polyfit(way_rad[before], torque, 1)[0] == pytest.approx(2.0, rel=0.01)
    assert np.polyfit(way_rad[after], equal[after], 1)[0] == pytest.approx(0.1, rel=0.01)
    assert np.polyfit(way_rad[after], opposite[after], 1)[0] == pytest.approx(2.0, rel=0.01)
    assert equal[after][0] == pytest.approx(0.1, rel=0.05)


def test_loading_and_unloading_differ_by_the_loop_and_by_no_more():
    time_s = np.array([10.0, 30.0])  # the same place on the way out and back
    out, back = pushed(bench(), [0.0, 0.02, 0.0], [0.0, 20.0, 40.0], time_s)[:, 0]
    # Damping of 0.02 N m s/rad, and a beam of 200 N/m that is 20 ms late, at 1 mm/s out and back.
    slow = 2 * (0.02 * 0.01 / LEVER_M - 200 * 0.02 * 1e-3)
    assert out - back == pytest.approx(2 * 0.03 * 0.1 / LEVER_M + slow, rel=0.02)
    without = pushed(bench(as_modelled=True), [0.0, 0.02, 0.0], [0.0, 20.0, 40.0], time_s)[:, 0]
    assert without[0] - without[1] == pytest.approx(slow, rel=0.02)


def test_the_loop_is_that_of_an_independent_integration_of_bouc_and_wen():
    times, points = [0.0, 4.0, 9.0, 12.0], [0.0, 0.004, -0.003, 0.001]
    time_s = np.linspace(0.1, 12.0, 200)

    def slope(t, x):
        angle, z = x
        rate = (np.interp(t, times, points) / LEVER_M - angle) / 0.02
        return [rate, rate * (1 - z * z * (1 if rate * z > 0 else 0)) / 0.01]

    solved = solve_ivp(slope, (0.0, 12.0), [0.0, 0.0], max_step=2e-3, rtol=1e-8, atol=1e-10, t_eval=time_s)
    angle, z = solved.y
    rate = (np.interp(time_s, times, points) / LEVER_M - angle) / 0.02
    expected = (2.0 * angle + 0.02 * rate + 0.003 * z) / LEVER_M
    force = pushed(bench(), points, times, time_s)[:, 0]
    np.testing.assert_allclose(force, expected, atol=2e-4)


def test_a_tow_is_a_way_at_constant_speed():
    made = bench()
    made.observe(("position",), np.zeros(1))
    made.tow(0.0, 0.01, 0.002, 1.0)
    times = np.array([0.5, 1.0, 3.5, 6.0, 9.0])
    np.testing.assert_allclose(made.observe(("position",), times)[:, 0], [0, 0, 0.005, 0.01, 0.01], atol=1e-9)
    made.tow(0.01, 0.01, 0.0, 9.5)
    assert made.observe(("bend",), np.array([10.0]))[0, 0] == pytest.approx(0.1)


def test_another_beam_is_mounted_where_the_condition_names_it_and_none_that_there_is_not():
    made = bench()
    made.arrange({"reach": 3.0})
    assert made.truth()["beam"] == "long"
    made.arrange({"beam": "short"})
    assert made.truth()["parameters"]["equal_limit"] == pytest.approx(0.65)
    with pytest.raises(SpecError, match=r"no beam 'shrot'(.|\n)*long, short"):
        made.arrange({"beam": "shrot"})


def test_every_mounting_is_a_little_different_and_the_seed_says_how():
    def stiffness(seed, **keys):
        made = BeamBench(keys, np.random.default_rng(seed))
        first = made.truth()["parameters"]["stiffness"]
        made.arrange({"beam": "short"})
        made.arrange({"beam": "long"})
        return first, made.truth()["parameters"]["stiffness"]

    assert stiffness(1) == stiffness(1)
    assert stiffness(1) != stiffness(2)
    first, second = stiffness(1)
    assert first != second
    spread = np.std([stiffness(seed)[0] for seed in range(200)])
    assert spread == pytest.approx(0.01 * 2.0, rel=0.2)
    assert stiffness(1, as_modelled=True) == (2.0, 2.0)


def test_a_stored_bench_continues_to_the_last_bit():
    later = 20.0 + np.arange(0.0, 5.0, 0.013)

    def moved():
        made = BeamBench({"hide": [{"effect": "lag", "site": "pusher"}]}, np.random.default_rng(4))
        pushed(made, [0.0, -0.02, 0.01], [0.0, 10.0, 30.0], [19.0])
        return made

    made, other = (
        moved(),
        BeamBench({"hide": [{"effect": "lag", "site": "pusher"}]}, np.random.default_rng(9)),
    )
    other.restore(json.loads(json.dumps(made.snapshot())))
    signals = tuple(made.signals)
    np.testing.assert_array_equal(other.observe(signals, later), moved().observe(signals, later))
    assert other.truth() == made.truth()


@pytest.mark.parametrize(
    ("effect", "site"),
    [
        ("coulomb-friction", "beam"),
        ("cubic-stiffness", "beam"),
        ("lag", "pusher"),
        ("gain-error", "force"),
    ],
)
def test_effects_hide_in_the_beam_in_the_pusher_and_in_the_cell(effect, site):
    plain = pushed(bench(), [0.0, 0.02, 0.0], [0.0, 20.0, 40.0], [10.0, 30.0])[:, 0]
    made = bench(hide=[{"effect": effect, "site": site}])
    assert [hidden["effect"] for hidden in made.truth()["hidden"]] == [effect]
    assert (
        np.max(np.abs(pushed(made, [0.0, 0.02, 0.0], [0.0, 20.0, 40.0], [10.0, 30.0])[:, 0] - plain)) > 1e-3
    )
    assert site in {location.name for location in made.places}


def test_errors_of_parameters_are_those_that_were_asked_for():
    made = bench(parameters={"stiffness": 0.1})
    assert made.truth()["parameters"]["stiffness"] == pytest.approx(2.2)
    with pytest.raises(SpecError, match="stiffnes"):
        bench(parameters={"stiffnes": 0.1})


def test_it_is_found_under_its_name():
    assert registry.load("labrun.scenes", "beam-bench") is BeamBench
