"""Benches that have to be what a model says, but for what they hide: as a sealed dry run makes them."""

import json

import numpy as np
import pytest
from simulated_bench import line, sine

from labrun import registry

BENCHES = {
    "hinge-bench": "hinge",
    "driven-joint": "angle",
    "caudal-tank": "torque_y",
    "fire-tank": "torque_z",
    "spm-stabiliser": "theta_1",
}
DRIVEN = {
    "hinge-bench": "hinge",
    "driven-joint": "base",
    "caudal-tank": "tail",
    "fire-tank": "tail",
    "spm-stabiliser": "servo_1",
}


def bench(name, hide=(), *, as_modelled=True, **more):
    settings = {"noise": 0, "hide": list(hide), "as_modelled": as_modelled, **more}
    made = registry.load("labrun.scenes", name)(settings, np.random.default_rng(0))
    made.observe([BENCHES[name]], np.array([0.0]))
    return made


def moved(name, hide=(), **more):
    made = bench(name, hide, **more)
    motion = (
        line("hinge", [0.0, 40.0, 40.0], [0.0, 1.0, 2.0])
        if name == "hinge-bench"
        else sine(DRIVEN[name], 30, 1.4, 8.0)
    )
    made.drive(DRIVEN[name], motion, 0.5)
    return made


@pytest.mark.parametrize("name", BENCHES)
def test_every_site_that_a_bench_names_takes_an_effect(name):
    effect = {"input": "gain-error", "output": "bias", "joint": "coulomb-friction", "body": "drag-error"}
    for site in bench(name).places:
        hide = [{"effect": effect[site.kind], "site": site.name, "kind": site.kind}]
        assert bench(name, hide).truth()["hidden"][0]["site"] == site.name


@pytest.mark.parametrize("name", BENCHES)
def test_the_memory_of_a_sealed_bench_tells_nothing_and_restores_it_exactly(name):
    site = bench(name).places[-1]
    hide = [{"effect": "lag", "site": site.name, "kind": "output"}]
    first_move = moved(name, hide)
    first_move.observe([BENCHES[name]], np.arange(0.0, 4.0, 0.01))
    stored = json.loads(json.dumps(first_move.snapshot()))
    assert list(stored) == ["sealed"]
    other = bench(name, hide)
    other.restore(stored)
    later = np.arange(4.0, 6.0, 0.01)
    np.testing.assert_array_equal(
        other.observe([BENCHES[name]], later), first_move.observe([BENCHES[name]], later)
    )


def test_without_a_seal_the_memory_is_plain_as_before():
    assert "memory" in bench("hinge-bench", as_modelled=False).snapshot()


def test_the_hinge_as_modelled_has_the_damping_of_the_map_and_no_drag():
    plain, modelled = bench("hinge-bench", as_modelled=False).truth(), bench("hinge-bench").truth()
    assert modelled["built_in"][0]["values"]["coefficient"] == 0.0
    assert plain["built_in"][0]["values"]["coefficient"] > 0.0
    assert modelled["parameters"]["damping"] > plain["parameters"]["damping"]


def test_the_cameras_flaw_shows_while_the_body_is_held_as_well_as_when_it_swings():
    times = np.arange(1.6, 6.0, 0.01)
    offset = [{"effect": "bias", "site": "angle", "values": {"offset": 0.05}}]
    change = moved("hinge-bench", offset).observe(["hinge"], times) - moved("hinge-bench").observe(
        ["hinge"], times
    )
    np.testing.assert_allclose(change, 0.05, atol=1e-12)


def test_a_late_camera_sees_the_release_late():
    late = [{"effect": "delay", "site": "angle", "values": {"delay": 0.05}}]
    times = np.arange(2.0, 6.0, 0.01)
    seen = moved("hinge-bench", late).observe(["hinge"], times)
    true = moved("hinge-bench").observe(["hinge"], times - 0.05)
    np.testing.assert_allclose(seen, true, atol=1e-6)


def test_a_sensors_flaw_on_one_axis_leaves_the_others_alone():
    times = np.arange(1.0, 6.0, 0.01)
    axes = ["torque_y", "torque_x", "force_x"]
    gain = [{"effect": "gain-error", "site": "torque_y", "values": {"error": 0.2}}]
    flawed, plain = moved("caudal-tank", gain).observe(axes, times), moved("caudal-tank").observe(axes, times)
    np.testing.assert_allclose(flawed[:, 0], 1.2 * plain[:, 0], atol=1e-12)
    np.testing.assert_array_equal(flawed[:, 1:], plain[:, 1:])


def test_a_force_on_the_fin_stands_square_to_the_sheet():
    times = np.arange(1.0, 6.0, 0.01)
    pull = [{"effect": "drag-error", "site": "fin", "values": {"coefficient": 1e-3}}]
    change = moved("caudal-tank", pull).observe(["force_x", "force_y"], times)
    change -= moved("caudal-tank").observe(["force_x", "force_y"], times)
    size = np.hypot(change[:, 0], change[:, 1])
    assert size.max() > 1e-3
    strong = size > 0.3 * size.max()
    # the sheet swings through some 25 degrees: the force stays that near to sideways
    assert np.degrees(np.arctan2(np.abs(change[strong, 0]), np.abs(change[strong, 1]))).max() < 30
