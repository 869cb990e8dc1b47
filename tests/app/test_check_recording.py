"""A recording is checked as fits and diagnoses read it: what is in it, what is doubtful, what to do next."""

import numpy as np
import pytest

from labrun.app.check import is_meant_as_recording
from labrun.app.check_recording import check_recording
from labrun.app.fit import fit
from labrun.errors import RecordingError, RequestError

SWING = """
name = "swing"
states = ["angle", "rate"]
[parameters]
damping = { value = 0.5, tolerance = "free", unit = "1/s" }
[equations]
angle = "rate"
rate = "-9*angle - damping*rate"
[outputs]
angle = { equation = "angle", unit = "rad" }
[initial]
angle = "release_rad"
rate = 0.0
"""


def swing(folder, *, scale=1.0, model=SWING, head="", release="release_rad", samples=20):
    folder.mkdir()
    times_s = 0.05 * np.arange(samples)
    toml = [head, "[channels.angle]", 'kind = "output"', 'unit = "rad"']
    for trial, start in enumerate((0.2, 0.2, 0.4)):
        angle = scale * start * np.exp(-0.25 * times_s) * np.cos(3 * times_s)
        rows = [f"{time:.3f},{value:.6f}" for time, value in zip(times_s, angle, strict=True)]
        (folder / f"{trial}.csv").write_text("\n".join(["time_s,angle", *rows]) + "\n")
        toml += ["[[trials]]", f'file = "{trial}.csv"', f"condition = {{ {release} = {start} }}"]
    (folder / "recording.toml").write_text("\n".join(toml) + "\n")
    if model:
        (folder / "model.toml").write_text(model)
    return folder


def test_what_a_recording_holds_is_said_with_how_far_its_model_is_off_and_what_to_type_next(tmp_path):
    recording = check_recording(swing(tmp_path / "arm"))
    assert "3 trials" in recording.to_text()
    assert "2 conditions, each measured 1 to 2 times" in recording.to_text()
    off, spread = recording.off["angle"]
    assert off < 0.1 * spread
    assert recording.remarks == ()
    assert recording.next == f"labrun gap diagnose {tmp_path / 'arm'}"
    assert recording.to_json()["channels"][0]["highest"] == pytest.approx(0.4)


def test_an_angle_in_degrees_that_is_said_to_be_in_radians_is_doubted(tmp_path):
    recording = check_recording(swing(tmp_path / "arm", scale=180 / np.pi))
    assert recording.remarks == ("angle is said to be in rad and reaches 22.92: is it in degrees?",)


def test_a_model_that_is_far_from_what_was_measured_is_looked_at_first(tmp_path):
    recording = check_recording(swing(tmp_path / "arm", model=SWING.replace("-9*angle", "90 - 9*angle")))
    assert "look at units, signs and beginnings first" in recording.remarks[0]


def test_a_model_whose_simulation_does_not_stay_finite_is_told_and_not_diagnosed_first(tmp_path):
    unstable = SWING.replace("-9*angle", "1e9*angle^3")
    recording = check_recording(swing(tmp_path / "arm", model=unstable))
    assert recording.off == {}
    assert "leaves the finite numbers" in recording.remarks[0]


def test_without_a_model_the_recording_alone_is_checked(tmp_path):
    recording = check_recording(swing(tmp_path / "arm", model=""))
    assert recording.model == ""
    assert "--model FILE" in recording.next


def test_a_condition_or_a_file_that_is_not_there_is_refused_by_name(tmp_path):
    with pytest.raises(RequestError, match="release_rad"):
        check_recording(swing(tmp_path / "arm", release="angle_rad"))
    swing(tmp_path / "hole")
    (tmp_path / "hole" / "1.csv").rename(tmp_path / "hole" / "one.csv")
    with pytest.raises(RecordingError, match=r"1\.csv does not exist"):
        check_recording(tmp_path / "hole")


def test_a_folder_or_its_table_is_meant_as_a_recording_and_the_name_of_an_experiment_is_not(tmp_path):
    folder = swing(tmp_path / "arm")
    assert is_meant_as_recording(str(folder))
    assert is_meant_as_recording(str(folder / "recording.toml"))
    assert is_meant_as_recording("table-3-2")
    assert not is_meant_as_recording("hinge")
    assert not is_meant_as_recording("nothing-of-this-name")


def with_time_jump(folder, trial, jump_s=2.0):
    """Let a trial's clock jump after its 8th sample."""
    lines = (folder / f"{trial}.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    moved = [f"{float(t) + jump_s * (index >= 8):.3f},{value}" for index, (t, value) in enumerate(rows)]
    (folder / f"{trial}.csv").write_text("\n".join([lines[0], *moved]) + "\n")
    return folder


def test_a_fit_leaves_out_the_trial_in_which_time_jumps_and_says_what_the_check_says(tmp_path):
    folder = with_time_jump(swing(tmp_path / "arm", samples=60), 1)
    checked = check_recording(folder)
    fitted = fit(folder, results=tmp_path)
    assert any("1.csv:10 (2.05 s)" in remark for remark in checked.remarks)
    assert fitted.warnings[: len(checked.remarks)] == checked.remarks
    assert fitted.parameters["damping"].value == pytest.approx(0.5, abs=0.1)
    assert (fitted.data.trials, fitted.data.left_out) == (2, 1)
    assert not any("controller" in warning for warning in fitted.warnings)


def test_a_fit_of_signals_leaves_out_the_trial_in_which_time_jumps(tmp_path):
    folder = with_time_jump(swing(tmp_path / "arm", samples=60), 1)
    settings = {
        "inputs": {"x": "angle"},
        "outputs": {"y": "angle"},
        "baskets": {"a": ["x"]},
        "average": "none",
        "block_s": 0.5,
    }
    fitted = fit(folder, model="least-squares", settings=settings, results=tmp_path)
    assert (fitted.data.trials, fitted.data.left_out) == (2, 1)
    assert any("time jumps there: trial 1" in warning for warning in fitted.warnings)


def test_a_fit_says_what_the_check_doubts(tmp_path):
    folder = swing(tmp_path / "arm", scale=180 / np.pi)
    fitted = fit(folder, results=tmp_path)
    assert "angle is said to be in rad and reaches 22.92: is it in degrees?" in fitted.warnings


def test_a_recording_whose_time_jumps_in_every_trial_is_refused_by_check_and_fit_alike(tmp_path):
    folder = swing(tmp_path / "arm", samples=60)
    for trial in range(3):
        with_time_jump(folder, trial)
    for use in (check_recording, fit):
        with pytest.raises(RecordingError, match="time jumps in every trial"):
            use(folder)


def step(rows, first, end=None, by=2 * np.pi):
    rows[first:end, 2] += by
    return rows


def second_writer(rows):
    rows[::2, 2] = 0
    return rows


def frozen(rows):
    rows[100:150, 2] = rows[100, 2]
    return rows


@pytest.mark.parametrize(
    ("change", "names", "expected"),
    [
        (
            lambda rows: step(rows, 30),
            "",
            "angle jumps by 6.283 rad between two samples: did its counter wrap? (1 time, first at line 32 of 1.csv)",
        ),
        (
            lambda rows: step(rows, 30, 31),
            "",
            "angle lies 6.283 rad off for a sample or two: a glitch of its counter? "
            "(1 time, first at line 32 of 1.csv)",
        ),
        (
            lambda rows: step(rows, 0),
            "",
            "angle is measured +1 whole turns from angle_command: did it lose a turn? (1.csv)",
        ),
        (
            second_writer,
            "",
            "angle goes away and back from sample to sample, as if two sources wrote it (1.csv)",
        ),
        (frozen, "", "angle is frozen (lines 102 to 151 of 1.csv)"),
        (lambda rows: rows * [1000, 1, 1], "", "time_s steps by 10 s: are they milliseconds, or less?"),
        (
            lambda rows: np.column_stack([rows, 0.98 * rows[:, 0]]),
            ",sim_time",
            "stamps are time_s; sim_time holds time as well and runs at 0.98 of it: which clock is the robot's?",
        ),
        (
            lambda rows: np.column_stack([rows, np.arange(len(rows)) // 100]),
            ",episode",
            "1.csv: episode tells 3 episodes in one trial: each is a trial, with a file of its own",
        ),
        (
            lambda rows: np.column_stack([rows, rows[:, 1]]),
            ",tau_con",
            "1.csv: tau_con: not used, as recording.toml has no such channel",
        ),
    ],
    ids=["wrap", "glitch", "turn", "writers", "frozen", "milliseconds", "clocks", "episodes", "unused"],
)
def test_what_an_import_doubts_is_told_of_a_recording_with_its_lines(tmp_path, change, names, expected):
    time_s = 0.01 * np.arange(300)
    command = 0.5 * np.sin(2 * time_s)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(300)
    rows = change(np.column_stack([time_s, command, command + noise]))
    channels = [
        f'[channels.{name}]\nkind = "{kind}"\nunit = "rad"'
        for name, kind in (("angle_command", "input"), ("angle", "output"))
    ]
    (tmp_path / "recording.toml").write_text("\n".join([*channels, '[[trials]]\nfile = "1.csv"']))
    np.savetxt(
        tmp_path / "1.csv", rows, delimiter=",", header=f"time_s,angle_command,angle{names}", comments=""
    )
    remarks = check_recording(tmp_path).remarks
    assert remarks[-2] == expected


@pytest.mark.parametrize("encoding", ["utf-16", "cp1252"])
def test_a_recording_in_another_encoding_is_refused_by_its_name(tmp_path, encoding):
    folder = swing(tmp_path / "arm")
    (folder / "1.csv").write_text(
        "time_s,angle,H\N{LATIN SMALL LETTER O WITH DIAERESIS}he\n0,0,0\n1,0,0\n", encoding=encoding
    )
    with pytest.raises(RecordingError, match="UTF-16" if encoding == "utf-16" else "Windows-1252"):
        check_recording(folder)
