"""A plugin package of somebody else: installed beside labrun, found, used; a broken one named with its cause."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "third_party" / "labrun-paddle"

EXPERIMENT = """
title = "Impulse of a triangle-wave paddle"
kind = "sweep"
[rig]
scene = "caudal-tank"
[rig.devices.tail]
plugin = "arduino-servo"
port = "/dev/ttyACM0"
limits = { angle_deg = [-60, 60] }
[rig.devices.cell]
plugin = "load-cell"
[gait]
plugin = "triangle"
joints.tail = { amplitude_deg = "a", frequency_hz = "f" }
[trial]
cycles = 4
repeats = 2
settle = { channel = "cell.force_x", hold_s = 1, timeout_s = 30 }
[sweep]
axes = { a = [20, 50], f = [1.4] }
[objectives.push]
plugin = "impulse"
channel = "cell.force_x"
goal = "maximise"
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """A folder with the package installed as pip installs it."""
    folder = tmp_path_factory.mktemp("site")
    install = [
        "install",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--target",
        str(folder),
        str(PACKAGE),
    ]
    subprocess.run([sys.executable, "-m", "pip", *install], check=True, timeout=300)
    return folder


@pytest.fixture
def env(site) -> dict[str, str]:
    return {"PYTHONPATH": os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])}


def test_plugins_lists_it_with_its_origin_and_the_broken_one_with_its_cause(labrun, env):
    entries = {entry["name"]: entry for entry in labrun("plugins", "--json", env=env).json["plugins"]}
    for name in ("simulated-load-cell", "triangle", "impulse"):
        assert entries[name]["origin"] == "labrun-paddle 1.2.3"
        assert entries[name]["cause"] == ""
    assert "a_library_that_nobody_has" in entries["broken"]["cause"]


def test_an_experiment_runs_on_its_device_gait_and_objective(labrun, env, tmp_path):
    (tmp_path / "paddle.toml").write_text(EXPERIMENT)
    done = labrun("sweep", "paddle", "--dry-run", "--seed", "3", "--json", env=env)
    assert done.code == 0, done.err
    assert done.json["trials"]["done"] >= 4
    assert done.json["best"]["objective"]["unit"] == "N s"
    assert done.json["best"]["parameters"]["a"] == 50


def test_an_experiment_that_uses_the_broken_one_says_why_it_cannot_run(labrun, env, tmp_path):
    (tmp_path / "paddle.toml").write_text(EXPERIMENT.replace('"impulse"', '"broken"'))
    done = labrun("sweep", "paddle", "--dry-run", env=env)
    assert done.code == 2
    assert "a_library_that_nobody_has" in done.err
    assert "labrun-paddle" in done.err
