"""What is known of four recordings that nobody here made."""

from pathlib import Path

import numpy as np
import pytest

from labrun.fit.dataset import load_dataset
from labrun.fit.output_error import fit_model
from labrun.fit.result import FitResult
from labrun.models import load_model, parse_model
from labrun.store import read_recording


def fitted(folder: Path, model_text: str | None = None, *, starts: int = 5) -> FitResult:
    model = load_model(folder / "model.toml") if model_text is None else parse_model(model_text, "model.toml")
    return fit_model(model, load_dataset(folder, model), rng=np.random.default_rng(0), starts=starts)


@pytest.mark.parametrize(
    ("name", "trials", "samples"),
    [("ring-down", 6, 1834), ("xl330-servo", 16, 1200), ("emps", 4, 1553), ("silverbox", 4, 4096)],
)
def test_every_recording_is_read(recordings: Path, name: str, trials: int, samples: int) -> None:
    recording = read_recording(recordings / name)
    assert len(recording.trials) == trials
    assert all(abs(len(trial.time_s) - samples) <= 1 for trial in recording.trials)


def test_the_ring_down_follows_its_model_to_a_few_milliradians(recordings: Path) -> None:
    result = fitted(recordings / "ring-down")
    # per piece, as it was checked when the recording was made; over all samples the worst piece weighs more
    pieces = [float(np.sqrt(np.mean(part**2))) for part in result.residuals]
    assert np.mean(pieces) == pytest.approx(6e-3, rel=0.1)
    assert result.rmse["angle"] < 9e-3


def test_the_emps_drive_has_its_published_friction(recordings: Path) -> None:
    text = (recordings / "emps" / "model.toml").read_text().replace("tolerance = 0.1", 'tolerance = "free"')
    text = text.replace(
        "[equations]",
        'friction = { value = 20.0, tolerance = "free", unit = "N" }\n'
        'offset = { value = 1.0, tolerance = "free", unit = "N" }\n[equations]',
    ).replace("- damping*speed", "- damping*speed - friction*tanh(speed/1e-3) - offset")
    result = fitted(recordings / "emps", text)
    assert result.rmse["position"] < 2e-3
    # published: 95.1 kg, 204 N s/m, 20.3 N, one part at a time
    assert result.parameters["mass"].value == pytest.approx(95.1, rel=0.1)
    assert result.parameters["damping"].value == pytest.approx(204, rel=0.15)
    assert result.parameters["friction"].value == pytest.approx(20.3, rel=0.15)


def test_the_silverbox_needs_a_cubic_spring_and_an_offset(recordings: Path) -> None:
    plain = fitted(recordings / "silverbox", starts=1)
    assert 5e-3 < plain.rmse["response"] < 12e-3
    text = (recordings / "silverbox" / "model.toml").read_text()
    text = text.replace(
        "[equations]",
        'cubic = { value = 5e5, tolerance = "free", unit = "1/(V^2 s^2)" }\n'
        'offset = { value = 100.0, tolerance = "free", unit = "V/s^2" }\n[equations]',
    ).replace("- damping*rate", "- damping*rate - cubic*response^3 - offset")
    assert fitted(recordings / "silverbox", text, starts=1).rmse["response"] == pytest.approx(
        0.35e-3, rel=0.1
    )


def test_the_servo_is_fitted_with_its_gap_left_in(recordings: Path) -> None:
    result = fitted(recordings / "xl330-servo", starts=1)
    assert 0.05 < result.rmse["angle"] < 0.3
    assert set(result.parameters) == {"rotor_inertia", "torque_const", "resistance"}
