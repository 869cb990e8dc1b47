"""A small experiment file that holds, to be broken in one place at a time."""

from collections.abc import Callable
from pathlib import Path

import pytest

from labrun.errors import SpecError
from labrun.experiment import LoadedExperiment, load_experiment
from labrun.toml import LocatedFault

GOOD = """\
title = "Thrust over amplitude and frequency"
kind = "sweep"

[rig]
scene = "caudal-tank"

[rig.devices.tail]
plugin = "arduino-servo"
port = "/dev/ttyACM0"
limits = { angle_deg = [-60, 60], speed_deg_s = 528 }

[rig.devices.wrench]
plugin = "robotiq-ft300"
port = "/dev/ttyUSB0"
limits = { force_n = 300 }

[gait]
plugin = "sine"
joints.tail = { amplitude_deg = "a", frequency_hz = "f" }

[trial]
cycles = 5
discard_cycles = 1
repeats = 3
settle = { channel = "wrench.force_x", timeout_s = 60 }

[sweep]
axes = { a = { from = 10, to = 60, step = 5 }, f = [0.5, 1.0, 1.5] }
where = ["a * f <= 84"]

[objectives.thrust]
plugin = "cycle-mean"
channel = "wrench.force_x"
goal = "maximise"
"""


@pytest.fixture
def good() -> str:
    """Text of a file that holds."""
    return GOOD


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write the good file, with replacements of some of its text."""

    def _write(*replacements: tuple[str, str]) -> Path:
        text = GOOD
        for old, new in replacements:
            assert text.count(old) >= 1, f"{old!r} is not in the good file"
            text = text.replace(old, new, 1)
        path = tmp_path / "thrust.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return _write


@pytest.fixture
def load(write: Callable[..., Path]) -> Callable[..., LoadedExperiment]:
    """Load the good file with replacements."""
    return lambda *replacements, overrides=(): load_experiment(write(*replacements), overrides)


@pytest.fixture
def problems(write: Callable[..., Path]) -> Callable[..., tuple[LocatedFault, ...]]:
    """Return what is wrong with the good file after replacements."""

    def _problems(
        *replacements: tuple[str, str], overrides: tuple[str, ...] = ()
    ) -> tuple[LocatedFault, ...]:
        with pytest.raises(SpecError) as caught:
            load_experiment(write(*replacements), overrides)
        return tuple(LocatedFault(**fault) for fault in caught.value.details["problems"])

    return _problems
