"""Measured trials reach a model under its own names, on the time base of its outputs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labrun.devices import Channel, Samples, Trajectory
from labrun.errors import FitError, RequestError
from labrun.fit.dataset import load_dataset, thinned, until_peak
from labrun.models import Between, Model, parse_model
from labrun.store import RunFolder, TrialOutcome, import_recording

MODEL = """
name = "arm"
states = ["angle"]
inputs = ["command"]
[parameters]
rate = { value = 1.0, tolerance = "free", unit = "1/s" }
[equations]
angle = "rate*(command - angle)"
[outputs]
angle = "angle"
"""
RECORDING = """
experiment = "arm"
[channels.command]
kind = "input"
unit = "rad"
between = "hold"
[channels.angle]
kind = "output"
unit = "rad"
[[trials]]
file = "a.csv"
condition = { load = 1, body = "wide" }
[[trials]]
file = "b.csv"
condition = { load = 1, body = "wide" }
"""


@pytest.fixture
def model() -> Model:
    return parse_model(MODEL, "arm.toml")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    folder = tmp_path / "recording"
    folder.mkdir()
    (folder / "recording.toml").write_text(RECORDING)
    for name, start_s in (("a", 0.0), ("b", -0.05)):
        rows = [f"{start_s + 0.1 * row:.2f},{row % 2},{0.5 * row}" for row in range(12)]
        (folder / f"{name}.csv").write_text("\n".join(["time_s,command,angle", *rows]) + "\n")
    return folder


def stored_run(
    folder: Path, statuses: tuple[str, ...] = ("done", "rejected", "done"), camera_begins_s: float = -0.2
) -> Path:
    """Return a run of a 50 Hz camera and a 20 Hz gauge beside a commanded joint."""
    run = RunFolder.create(folder, "arm", 'title = "arm"\n[rig]\n[units]\nload = "g"\n', {})
    for index, status in enumerate(statuses):
        writer = run.writer(index)
        camera_s = np.arange(camera_begins_s, 2.2, 0.02)
        gauge_s = np.arange(-0.2, 2.2, 0.05)
        writer.append("cameras", (Channel("angle", "rad"),), 50.0, samples(camera_s, np.sin(camera_s)))
        writer.append("gauge", (Channel("force", "N"),), 20.0, samples(gauge_s, 3.0 + 2.0 * gauge_s))
        outcome = TrialOutcome(
            index,
            {"load": 1.0},
            index,
            status=status,
            duration_s=2.0,
            tare={"gauge.force": 3.0},  # type: ignore[arg-type]
        )
        command_s = np.array([0.0, 1.0, 2.0])
        writer.finish(outcome, None, Trajectory(("tail",), command_s, np.array([[0.0], [1.0], [0.0]])))
    return run.path


def samples(time_s: np.ndarray, values: np.ndarray) -> Samples:
    return Samples(time_s, time_s, values[:, None])


def test_a_recording_is_found_by_the_models_names(recording: Path, model: Model) -> None:
    dataset = load_dataset(recording, model)
    assert dataset.kind == "recording"
    assert [trial.label for trial in dataset.trials] == [
        "load = 1, body = wide, repeat 1", "load = 1, body = wide, repeat 2",
    ]  # fmt: skip
    assert dataset.inputs[0].between == "hold"
    np.testing.assert_array_equal(dataset.trials[0].outputs[:, 0], 0.5 * np.arange(12))


def test_an_imported_recording_gives_the_same_data(recording: Path, model: Model, tmp_path: Path) -> None:
    direct = load_dataset(recording, model)
    imported = load_dataset(import_recording(recording, tmp_path / "results"), model)
    assert imported.kind == "run"
    assert imported.inputs == direct.inputs
    for first, other in zip(direct.trials, imported.trials, strict=True):
        np.testing.assert_array_equal(np.diff(first.time_s), np.diff(other.time_s))
        np.testing.assert_array_equal(first.outputs, other.outputs)
        np.testing.assert_array_equal(first.inputs, other.inputs)
        assert first.condition == other.condition


def test_signals_rename_channels(recording: Path) -> None:
    other = parse_model(MODEL.replace("angle", "tilt"), "arm.toml")
    with pytest.raises(RequestError, match="output 'tilt' is not an output channel"):
        load_dataset(recording, other)
    dataset = load_dataset(recording, other, {"tilt": "angle"})
    assert dataset.outputs[0].name == "tilt"


@pytest.mark.parametrize(
    ("signals", "expected"),
    [({"angle": "angel"}, "did you mean 'angle'"), ({"nothing": "angle"}, "neither an input nor an output")],
)
def test_a_signal_that_is_not_there_is_an_error(
    recording: Path, model: Model, signals: dict[str, str], expected: str
) -> None:
    with pytest.raises(RequestError) as caught:
        load_dataset(recording, model, signals)
    assert expected in str(caught.value)


def test_units_that_differ_are_an_error(recording: Path) -> None:
    degrees = parse_model(
        MODEL.replace(
            '[outputs]\nangle = "angle"', '[outputs]\nangle = { equation = "angle", unit = "deg" }'
        ),
        "arm.toml",
    )
    with pytest.raises(RequestError, match=r"in deg, the channel 'angle' of .* in rad"):
        load_dataset(recording, degrees)


def test_a_run_gives_accepted_trials_between_start_and_end(tmp_path: Path, model: Model) -> None:
    target = stored_run(tmp_path)
    dataset = load_dataset(target, model, {"angle": "cameras.angle", "command": "command.tail"})
    assert dataset.left_out == 1
    assert [trial.label for trial in dataset.trials] == ["trial 0: load = 1 g", "trial 2: load = 1 g"]
    trial = dataset.trials[0]
    assert trial.time_s[0] == pytest.approx(0.0, abs=1e-3)
    assert trial.time_s[-1] == pytest.approx(2.0, abs=1e-3)
    np.testing.assert_allclose(trial.outputs[:, 0], np.sin(trial.time_s), atol=1e-12)
    np.testing.assert_allclose(trial.inputs[:, 0], 1.0 - np.abs(trial.time_s - 1.0), atol=1e-9)


@pytest.mark.parametrize(("between", "begins_s"), [("linear", 0.0), ("band-limited", -0.013)])
def test_a_commanded_trial_begins_where_the_bench_still_stands_at_its_start_or_an_even_step_before(
    tmp_path: Path, model: Model, between: Between, begins_s: float
) -> None:
    signals = {"angle": "cameras.angle", "command": "command.tail"}
    model = replace(model, inputs=tuple(replace(signal, between=between) for signal in model.inputs))
    trial = load_dataset(stored_run(tmp_path, camera_begins_s=-0.193), model, signals).trials[0]
    np.testing.assert_allclose(trial.time_s[:2], [begins_s, 0.007], atol=1e-9)
    np.testing.assert_allclose(trial.inputs[:2, 0], [0.0, 0.007], atol=1e-9)


def test_outputs_of_two_devices_share_the_time_base_of_the_first_and_lose_their_tare(tmp_path: Path) -> None:
    text = MODEL + 'force = "2*t"\n'
    dataset = load_dataset(stored_run(tmp_path), parse_model(text, "arm.toml"), {"command": "command.tail"})
    trial = dataset.trials[0]
    assert [output.unit for output in dataset.outputs] == ["rad", "N"]
    np.testing.assert_allclose(trial.outputs[:, 1], 2.0 * trial.time_s, atol=1e-9)


def test_a_channel_nothing_recorded_is_named_with_the_nearest(tmp_path: Path, model: Model) -> None:
    with pytest.raises(RequestError, match=r"cameras.angle"):
        load_dataset(stored_run(tmp_path), model, {"angle": "camera.angle", "command": "command.tail"})


def test_a_run_without_an_accepted_trial_cannot_be_fitted(tmp_path: Path, model: Model) -> None:
    with pytest.raises(FitError, match="its only trial was rejected or failed"):
        load_dataset(stored_run(tmp_path / "one", ("rejected",)), model, {"command": "command.tail"})
    with pytest.raises(FitError, match="all 2 of its trials were rejected or failed"):
        load_dataset(stored_run(tmp_path / "two", ("rejected", "failed")), model, {"command": "command.tail"})


def test_a_trial_counts_up_to_where_a_signal_is_greatest_if_something_breaks_there(
    recording: Path, model: Model
) -> None:
    dataset = load_dataset(recording, model)
    assert until_peak(dataset, 0) is dataset  # it rises to the end
    broken = replace(
        dataset.trials[0], outputs=np.where(np.arange(12) < 8, dataset.trials[0].outputs.T, 0.0).T
    )
    result = until_peak(replace(dataset, trials=(broken, dataset.trials[1])), 0)
    assert [len(trial.time_s) for trial in result.trials] == [8, 12]
    assert result.notes == ("1 trial counts up to where angle is greatest only",)
    saturated = replace(broken, outputs=np.minimum(dataset.trials[0].outputs, 2.0))
    assert until_peak(replace(dataset, trials=(saturated,)), 0).trials == (saturated,)


def test_a_trial_is_cut_and_thinned_as_asked_and_says_so(recording: Path, model: Model) -> None:
    dataset = load_dataset(recording, model)
    time_s = dataset.trials[0].time_s
    rate_hz = 1.0 / (time_s[1] - time_s[0])
    result = thinned(dataset, rate_hz / 3.0, float(time_s[7] - time_s[0]) + 1e-9)
    np.testing.assert_array_equal(result.trials[0].time_s, time_s[[0, 3, 6]])
    np.testing.assert_array_equal(result.trials[0].outputs, dataset.trials[0].outputs[[0, 3, 6]])
    assert "trials were looked at up to" in result.notes[-1]
    same = thinned(dataset, 100.0 * rate_hz).trials[0]
    np.testing.assert_array_equal(same.inputs, dataset.trials[0].inputs)
