"""Every episode of a log is a trial, whole."""

import csv

import numpy as np
import pytest
import robot_logs as logs

from labrun.app.logs import LogAnswers, import_log, preview_log
from labrun.logs import ReadOptions, read_log
from labrun.store import read_recording

LENGTHS = (700, 300, 900, 180)


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(logs.ARM)
    return path


def episodes(seed=3):
    """Return time, goals and angles of episodes of different lengths, each with its own time from zero."""
    rng = np.random.default_rng(seed)
    made = []
    for number, length in enumerate(LENGTHS):
        time_s = np.arange(length) / logs.RATE_HZ
        goals = np.column_stack([0.5 * np.sin((1 + 0.2 * number) * time_s), 0.3 * np.cos(2 * time_s) - 0.3])
        angles = np.vstack([goals[:3], goals[:-3]]) + 1e-3 * rng.standard_normal(goals.shape)
        made.append((time_s, goals, angles))
    return made


def lengths_of(recording):
    return [len(trial.time_s) for trial in recording.trials]


@pytest.mark.parametrize("version", [2, 3])
def test_every_episode_of_a_lerobot_data_set_is_whole(tmp_path, arm, version):
    pytest.importorskip("pyarrow")
    made = episodes()
    goals, angles = (np.concatenate([episode[k] for episode in made]) for k in (1, 2))
    folder = logs.write_lerobot(tmp_path / "set", goals, angles, version=version, lengths=LENGTHS)
    result = import_log(folder, arm, tmp_path / "recording")
    recording = read_recording(result.folder)
    assert lengths_of(recording) == list(LENGTHS)
    for trial, (_, message, measured) in zip(recording.trials, made, strict=True):
        assert trial.inputs == pytest.approx(message, abs=1e-6)
        assert trial.outputs == pytest.approx(measured, abs=1e-6)
    assert not [text for text in result.remarks if "other topics" in text]


@pytest.mark.parametrize(
    ("name", "label"), [("episode", "{}"), ("trial", "run-{}"), ("episode_index", "{}.0")]
)
def test_a_column_that_names_episodes_cuts_a_csv_into_them(tmp_path, arm, name, label):
    with (tmp_path / "log.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time_s", name, "shoulder_cmd", "elbow_cmd", "shoulder_pos", "elbow_pos"])
        for number, (time_s, goals, angles) in enumerate(episodes()):
            rows.writerows(
                [t, label.format(number), *goal, *angle]
                for t, goal, angle in zip(time_s, goals, angles, strict=True)
            )
    result = import_log(tmp_path / "log.csv", arm, tmp_path / "recording")
    assert lengths_of(read_recording(result.folder)) == list(LENGTHS)
    assert f"log: {name} tells 4 episodes" in result.remarks
    assert "cut into its 4 episodes" in result.remarks


@pytest.mark.parametrize("stamped", [True, False])
def test_every_demo_of_an_hdf5_file_is_a_trial(tmp_path, arm, stamped):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for number, (time_s, goals, angles) in enumerate(episodes()):
            group = file.create_group(f"data/demo_{number}")
            group["obs/qpos"], group["ctrl"] = angles, goals
            if stamped:
                group["time"] = time_s
    answers = LogAnswers(rate_hz=None if stamped else logs.RATE_HZ)
    result = import_log(tmp_path / "log.h5", arm, tmp_path / "recording", answers=answers)
    assert lengths_of(read_recording(result.folder)) == list(LENGTHS)
    assert "log: 4 groups are 4 episodes, each a trial" in result.remarks


def test_each_of_several_arrays_of_time_stamps_its_own_array(tmp_path, arm):
    time_s, goals, angles = logs.motion()
    np.savez(tmp_path / "log.npz", t_ctrl=time_s[::2], ctrl=goals[::2], t_qpos=time_s + 0.003, qpos=angles)
    streams = read_log(tmp_path / "log.npz")
    rates = {stream.columns[0].name: round(1 / np.median(np.diff(stream.time_s))) for stream in streams}
    assert rates == {"ctrl[0]": 50, "qpos[0]": 100}
    recording = read_recording(import_log(tmp_path / "log.npz", arm, tmp_path / "recording").folder)
    assert len(recording.trials) == 3


def test_which_time_is_of_which_array_can_be_stated(tmp_path):
    time_s, goals, angles = logs.motion()
    np.savez(tmp_path / "log.npz", t0=0, time_a=time_s, time_b=time_s + 5.0, ctrl=goals, qpos=angles)
    options = ReadOptions(times={"ctrl": "time_a", "qpos": "time_b"})
    starts = {stream.columns[0].name: stream.time_s[0] for stream in read_log(tmp_path / "log.npz", options)}
    assert starts == {"ctrl[0]": 0.0, "qpos[0]": 5.0}


def test_arrays_without_stamps_of_as_many_samples_are_told_to_be_left_out(tmp_path, arm):
    time_s, goals, angles = logs.motion()
    np.savez(tmp_path / "log.npz", time=time_s, ctrl=goals, qpos=angles, imu=np.zeros((77, 3)))
    message = " ".join(preview_log(tmp_path / "log.npz", arm).remarks)
    assert "no stamps of as many samples for imu (77); left out" in message


def test_episodes_too_short_to_be_trials_are_counted(tmp_path, arm):
    time_s, goals, angles = logs.motion(moves=1)
    label = np.where(np.arange(len(time_s)) < 8, 0, 1)
    np.savez(tmp_path / "log.npz", time=time_s, ctrl=goals, qpos=angles, episode=label)
    result = import_log(tmp_path / "log.npz", arm, tmp_path / "recording")
    assert result.trials == 1
    assert any(text.startswith("8 samples (0.08 s) are in no trial") for text in result.remarks)


def test_several_logs_are_one_recording_with_the_log_in_its_conditions(tmp_path, arm):
    made = logs.motion()
    first = logs.write_csv(tmp_path / "monday.csv", *made)
    second = logs.write_npz(tmp_path / "tuesday.npz", *made)
    recording = read_recording(import_log([first, second], arm, tmp_path / "recording").folder)
    conditions = [trial.condition["log"] for trial in recording.trials]
    assert conditions == ["monday.csv"] * 3 + ["tuesday.npz"] * 3
    assert recording.trials[0].outputs == pytest.approx(recording.trials[3].outputs)
    rows = [row.column for row in preview_log([first, second], arm).channels if row.channel == "shoulder"]
    assert rows == ["monday.csv: shoulder_pos", "tuesday.npz: qpos[0]"]
