import pytest

from labrun.experiment import loads_experiment

MODEL = """
name   = "paddle"
states = ["x", "v"]
inputs = ["angle"]
[parameters]
length = { value = 0.1, tolerance = "free", unit = "m", lower = 0.01 }
drag   = { value = 2.0, tolerance = 0.1, unit = "1" }
[equations]
x = "v"
v = "30 * length * abs(angle) * (0.3 - length) - drag * v"
[outputs]
x = "x"
load = "length * abs(angle)"
[initial]
x = 0.0
v = 0.0
"""

FILE = """
title = "The length of a paddle and its stroke"
kind = "design"
[gait]
plugin = "sine"
joints.angle = { amplitude_deg = "stroke", frequency_hz = "f" }
[trial]
duration_s = 2
[objectives.distance]
plugin = "change"
channel = "simulation.x"
goal = "maximise"
[design]
model = "MODEL"
population = 12
where = ["length + 0.5 * stroke < 220", "peak_load < 0.08"]
stop = { iterations = 25 }
rate_hz = 50
parameters.length = "length / 1000"
parts.paddle = { from_mm = ["0", "0"], length_mm = "length", width_mm = "20" }
[design.variables]
length = { from = 20, to = 250, tolerance = 0.5 }
stroke = { from = 0, to = 60 }
f      = { from = 0.5, to = 2 }
[leaders]
count = 2
repeats = 5
[units]
length = "mm"
stroke = "deg"
f = "Hz"
"""


@pytest.fixture
def paddle(tmp_path, monkeypatch):
    """Return what writes the paddle's files into a fresh folder, with a text in them replaced, and loads them."""
    monkeypatch.chdir(tmp_path)

    def write(*changes: tuple[str, str], name: str = "paddle"):
        model = tmp_path / "paddle-model.toml"
        model.write_text(MODEL)
        text = FILE.replace("MODEL", str(model))
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / f"{name}.toml"
        path.write_text(text)
        return path

    return write


@pytest.fixture
def load():
    """Return what loads an experiment from its file."""
    return lambda path: loads_experiment(path.read_text(), path.stem, relative_to=path)
