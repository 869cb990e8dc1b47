import csv

import numpy as np
import pytest

from labrun.models import load_model, simulate


@pytest.mark.parametrize(
    ("folder", "file", "condition", "states"),
    [
        ("ring-down", "piece1.csv", {"piece": 1}, [-1.6, 2.0]),
        ("emps", "part1.csv", {"part": 1}, [0.0, 0.0]),
        ("silverbox", "stretch1.csv", {"stretch": 1}, [0.05, 0.0]),
        ("xl330-servo", "kp400_sin-sin.csv", {"kp": 400, "trajectory": "sin-sin"}, [0.0, 0.0]),
    ],
)
@pytest.mark.parametrize("between", ["linear", "hold", "band-limited"])
def test_the_models_beside_real_recordings_simulate(recordings, folder, file, condition, states, between):
    model = load_model(recordings / folder / "model.toml")
    with (recordings / folder / file).open() as stream:
        rows = list(csv.DictReader(stream))
    time_s = np.array([float(row["time_s"]) for row in rows])
    inputs = np.array([[float(row[signal.name]) for signal in model.inputs] for row in rows]).reshape(
        len(rows), len(model.inputs)
    )
    model = model.with_between(dict.fromkeys([signal.name for signal in model.inputs], between))
    result = simulate(model, time_s, inputs, condition=condition, initial_state=states)
    assert result.finite
    measured = np.array([[float(row[output.name]) for output in model.outputs] for row in rows])
    assert np.std(result.outputs) < 20 * np.std(measured)
