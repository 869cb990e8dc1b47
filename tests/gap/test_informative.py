"""An output that does not move is refused: any cause would seem to explain it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.errors import RecordingError
from labrun.fit.dataset import Dataset, FitTrial
from labrun.gap.data_checks import require_informative
from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.store import SignalInfo

from .benches import pendulum, recorded


def dataset(*columns: np.ndarray) -> Dataset:
    outputs = np.column_stack(columns)
    time_s = 0.01 * np.arange(len(outputs))
    trial = FitTrial("f = 1", {"f": 1.0}, 1, time_s, np.zeros((len(time_s), 1)), outputs)
    names = tuple(SignalInfo(f"angle_{number}", "rad") for number in range(1, len(columns) + 1))
    return Dataset("bench", Path("bench"), "recording", (SignalInfo("torque", "N m"),), names, (trial,))


SWING = np.sin(np.arange(100.0))


def test_the_only_output_constant_but_not_zero_is_refused_with_its_number() -> None:
    data = recorded(repeats=2)
    held = [replace(trial, outputs=np.full_like(trial.outputs, 0.7)) for trial in data.trials]
    with pytest.raises(RecordingError, match=r"'angle' is 0\.7 rad throughout pendulum") as caught:
        diagnose_dataset(replace(data, trials=tuple(held)), pendulum(), Options(places=False))
    assert "only output" in (caught.value.hint or "")


def test_a_constant_output_beside_others_is_refused_and_the_others_are_named() -> None:
    with pytest.raises(RecordingError, match="'angle_2'") as caught:
        require_informative(dataset(SWING, np.full(100, -3.0)))
    assert "take it out of the model's outputs, and diagnose with angle_1" in (caught.value.hint or "")


@settings(max_examples=50, deadline=None)
@given(level=st.floats(-1e6, 1e6), seed=st.integers(0, 99))
def test_rounding_about_a_constant_is_no_motion(level: float, seed: int) -> None:
    rounding = 1e-13 * np.random.default_rng(seed).standard_normal(100)
    with pytest.raises(RecordingError, match="throughout"):
        require_informative(dataset(SWING, level * (1.0 + rounding)))


@pytest.mark.parametrize("steps", [1, 2])
def test_a_flickering_last_digit_is_no_motion(steps: int) -> None:
    flicker = 0.7 + 1e-3 * np.random.default_rng(1).integers(0, steps + 1, 100)
    with pytest.raises(RecordingError, match=f"no more than {steps} of its steps of 0.001 rad"):
        require_informative(dataset(flicker))


@settings(max_examples=50, deadline=None)
@given(size=st.floats(1e-9, 1e9), level=st.floats(-10.0, 10.0))
def test_whatever_moves_is_taken_however_small(size: float, level: float) -> None:
    if size > 1e-6 * abs(level):
        require_informative(dataset(level + size * SWING))


def test_a_coarse_sensor_that_follows_the_motion_is_taken() -> None:
    require_informative(dataset(np.round(4.0 * SWING)))


def test_static_trials_of_one_sample_are_taken() -> None:
    entry = dataset(np.array([0.1]))
    other = replace(entry.trials[0], outputs=np.array([[0.2]]))
    require_informative(replace(entry, trials=(*entry.trials, other)))
