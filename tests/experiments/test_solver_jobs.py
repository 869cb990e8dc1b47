"""Jobs for solvers that ship without one: any program that writes their table is compared with theory."""

import sys
import tomllib

import pytest

import labrun
from labrun.experiment import shipped_experiments

PLATE = """
import math, sys
given = dict(zip(sys.argv[1::2], sys.argv[2::2]))
angle, speed = math.radians(float(given["--angle-deg"])), float(given["--speed-m-s"])
force = 1000 * 5.352e-3 * speed**2 * math.sin(angle) * 1.08
open(given["--output"], "w").write("lift,drag\\n" + 2 * f"{force * math.cos(angle)},{force * math.sin(angle)}\\n")
"""
BEAM = """
import math, sys
given = dict(zip(sys.argv[1::2], sys.argv[2::2]))
theta, length = math.radians(float(given["--theta-deg"])), float(given["--length-mm"])
limit = 0.65 * 4.383e9 * 1e-9 / (12 * (1 - 0.35**2)) * theta * (1 + 2 / length)
open(given["--output"], "w").write("equal_limit,opposite_limit\\n" + 2 * f"{limit},{4 * limit}\\n")
"""


def solved(tmp_path, name, device, program, *more):
    script = tmp_path / "solver.py"
    script.write_text(program)
    text = (shipped_experiments() / f"{name}.toml").read_text()
    run = tomllib.loads(text)["rig"]["devices"][device]["run"]
    arguments = [sys.executable, str(script), *run[2:]]
    keys = [f"rig.devices.{device}.run={arguments!r}", f"rig.devices.{device}.keep='{tmp_path}/kept'", *more]
    keys += [f"rig.devices.{device}.rate_hz=1000", "trial.duration_s=0.3"]
    return labrun.run(name, seed=1, overrides=keys, results=tmp_path / "results").run


@pytest.mark.parametrize(("tolerance", "within"), [("15%", True), ("5%", False)])
def test_a_flow_solver_is_held_against_the_flat_plate(tmp_path, tolerance, within):
    few = "sweep.axes={speed_m_s=[0.41], angle_deg=[0, 45, 90]}"
    run = solved(tmp_path, "flat-plate-cfd", "cfd", PLATE, few)
    result = labrun.compare(run, model="flat-plate", tolerance=tolerance)
    assert result.within is within
    assert result.comparison.worst.relative == pytest.approx(0.08 / 1.08, rel=0.02)


def test_a_finite_element_solver_is_held_against_the_theory_where_it_disagrees_most(tmp_path):
    few = "run.conditions=[{theta_deg=180,arc_mm=25.4,length_mm=6.4},{theta_deg=180,arc_mm=25.4,length_mm=50.8}]"
    run = solved(tmp_path, "curved-beam-fea", "fea", BEAM, few)
    comparison = labrun.compare(run, model=shipped_experiments() / "models" / "tape-spring.toml").comparison
    assert comparison.worst.condition["length_mm"] == 6.4
    assert comparison.worst.predicted == pytest.approx(0.850, abs=5e-4)
