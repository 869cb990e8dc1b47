"""A recording is read whole, or refused with every fault, each with file and line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.errors import RecordingError
from labrun.experiment import condition_text
from labrun.store.recording import read_recording

TOML = """\
experiment = "swing"
[channels.torque]
kind = "input"
unit = "N m"
between = "hold"
[channels.angle]
kind = "output"
unit = "rad"
[[trials]]
file = "a.csv"
condition = { release = 20, body = "wide" }
[[trials]]
file = "b.csv"
condition = { release = 20, body = "wide" }
"""
GOOD = "time_s,torque,angle\n0.0,1.0,0.1\n0.1,2.0,0.2\n0.2,3.0,0.3\n"


def write(folder: Path, toml: str = TOML, **files: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "recording.toml").write_text(toml)
    for name, text in {"a": GOOD, "b": GOOD, **files}.items():
        (folder / f"{name}.csv").write_text(text)
    return folder


def faults_of(folder: Path) -> str:
    with pytest.raises(RecordingError) as caught:
        read_recording(folder)
    return str(caught.value)


def test_a_sound_recording_is_read_with_its_units_and_conditions(tmp_path: Path) -> None:
    recording = read_recording(write(tmp_path / "r"))
    assert recording.name == "swing"
    assert [(signal.name, signal.unit, signal.between) for signal in recording.inputs] == [
        ("torque", "N m", "hold")
    ]
    assert [(signal.name, signal.unit) for signal in recording.outputs] == [("angle", "rad")]
    assert [trial.repeat for trial in recording.trials] == [1, 2]
    first = recording.trials[0]
    assert first.condition == {"release": 20.0, "body": "wide"}
    assert condition_text(first.condition) == "release = 20, body = wide"
    np.testing.assert_array_equal(first.time_s, [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(first.inputs, [[1.0], [2.0], [3.0]])
    np.testing.assert_array_equal(first.outputs, [[0.1], [0.2], [0.3]])
    assert first.source_file.name == "a.csv"


def test_columns_are_found_by_name_and_others_are_left_alone(tmp_path: Path) -> None:
    text = "\ufefftime_s,note,angle,torque\r\n0.0,start,0.1,1.0\r\n0.1,end,0.2,2.0\r\n\r\n"
    trial = read_recording(write(tmp_path / "r", a=text)).trials[0]
    np.testing.assert_array_equal(trial.outputs[:, 0], [0.1, 0.2])
    np.testing.assert_array_equal(trial.inputs[:, 0], [1.0, 2.0])


def test_quoted_cells_are_read(tmp_path: Path) -> None:
    text = 'time_s,"torque",angle,note\n0.0,"1.0",0.1,"a, b"\n0.1,2.0,0.2,c\n'
    np.testing.assert_array_equal(
        read_recording(write(tmp_path / "r", a=text)).trials[0].inputs[:, 0], [1.0, 2.0]
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "a.csv:1: the file is empty"),
        ("time_s,torque,angle\n", "a.csv:1: there is a header and no sample"),
        ("time_s,torque,angel\n0,1,1\n", "a.csv:1: column 'angle' is missing; the nearest is 'angel'"),
        ("t,torque,angle\n0,1,1\n", "a.csv:1: column 'time_s' is missing"),
        ("time_s,torque,angle,angle\n0,1,1,1\n", "a.csv:1: column 'angle' stands there twice"),
        ("time_s;torque;angle\n0;1;1\n", "a.csv:1: columns are separated by semicolons"),
        ("time_s,torque,angle\n0,1,1\n0.2,1,1\n0.1,1,1\n", "a.csv:4: time_s 0.1 does not follow 0.2 of line 3"),
        ("time_s,torque,angle\n0,1,1\n0,1,1\n", "a.csv:3: time_s 0 does not follow 0 of line 2"),
        ("time_s,torque,angle\n0,1,1\n0.1,nan,1\n", "a.csv:3: 'nan' is not finite in column 'torque'"),
        ("time_s,torque,angle\n0,1,1\n0.1,1,inf\n", "a.csv:3: 'inf' is not finite in column 'angle'"),
        ("time_s,torque,angle\n0,1,1\n0.1,,1\n0.2,1,1\n", "a.csv:3: a blank cell in column 'torque'"),
        ("time_s,torque,angle\n0,1,1\n0.1,1,off\n", "a.csv:3: 'off' is not a number in column 'angle'"),
        ("time_s,torque,angle\n0,1,1_0\n", "a.csv:2: '1_0' is not a number in column 'angle'"),
        ("time_s,torque,angle\n0,1,1\n0.1,1\n", "a.csv:3: a row of 2 cells; the header has 3 columns"),
        ("time_s,torque,angle\n0,1,1\n0.1,1,1,1\n", "a.csv:3: a row of 4 cells; the header has 3 columns"),
        ("time_s,torque,angle\n0,1,1\n\n0.1,1,1\n", "a.csv:3: a blank line"),
        ("time_s,torque,angle\n0,1,1\n0.1,1,\n0.2,1,\n", "a.csv:3: column 'angle' ends after line 2; the file"),
    ],
)  # fmt: skip
def test_a_bad_file_is_refused_with_its_line(tmp_path: Path, text: str, expected: str) -> None:
    message = faults_of(write(tmp_path / "r", a=text))
    assert expected in message
    assert "has a fault" in message


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('kind = "output"', 'kind = "ouput"', 'toml:7:8: channels.angle.kind = "ouput": expected "input" or "output"'),
        ('kind = "output"\n', "", 'recording.toml:6:2: channels.angle: the key "kind" is missing'),
        ('unit = "rad"\n', "", 'recording.toml:6:2: channels.angle: the key "unit" is missing'),
        ('between = "hold"', 'between = "held"', '(did you mean "hold"?)'),
        ('unit = "rad"', 'unit = "rad"\nbetween = "hold"', "between its samples; this is an output"),
        ('unit = "rad"', 'unit = "rad"\nreading_error = 0', "channels.angle.reading_error = 0: expected more than 0"),
        ("[channels.angle]", '[channels.v]\nkind="output"\nunit="1"\nreading_error=1\n[channels.angle]', "no reading"),
        ('unit = "rad"', 'unit = "rad"\nunits = "rad"', '9:1: channels.angle.units = "rad": unknown key; did you'),
        ('[channels.angle]\nkind = "output"', '[channels.angle]\nkind = "input"', "no channel has kind"),
        ('file = "b.csv"', 'file = "bb.csv"', "recording.toml:13: the file"),
        ('file = "b.csv"', 'file = "a.csv"', 'file = "a.csv": this is the file of the trial at line 10 already'),
        ('file = "b.csv"\n', "", 'recording.toml:12:3: trials[1]: the key "file" is missing'),
        ('file = "b.csv"', 'file = "b.csv"\nrepeat = 1', "repeat 1 of its condition, as is the trial at line 10"),
        ('file = "b.csv"', 'file = "b.csv"\nrepeat = 0', "trials[1].repeat = 0: expected more than 0"),
        ("release = 20", "release = nan", "trials[0].condition.release = nan: expected a finite number"),
        ("release = 20", "release = true", "condition.release = true: expected a number or text in quotes"),
        ("experiment = ", "experimnet = ", 'toml:1:1: experimnet = "swing": unknown key; did you mean'),
        ('kind = "output"', "kind = ", "recording.toml:7:8: not valid TOML"),
        (TOML, "", "recording.toml:1:1: channels: no channels"),
        (TOML[TOML.index("[[trials]]") :], "", "no trials; expected a table [[trials]]"),
        (TOML[TOML.index("[channels") : TOML.index("[[trials]]")], "", "no channels; expected a table [channels.NAME]"),
    ],
)  # fmt: skip
def test_a_bad_description_is_refused_with_its_line(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    assert old in TOML
    assert expected in faults_of(write(tmp_path / "r", TOML.replace(old, new, 1)))


def test_all_faults_are_told_at_once(tmp_path: Path) -> None:
    toml = TOML.replace('unit = "N m"', "").replace("[[trials]]\nfile", "[[trials]]\nfiel = 1\nfile", 1)
    message = faults_of(
        write(tmp_path / "r", toml, a="time_s,torque,angle\n0,1,x\n0,1,\n", b="time_s,torque\n0,1\n")
    )
    for expected in (
        'the key "unit" is missing',
        'unknown key; did you mean "file"?',
        "a.csv:2: 'x' is not a number",
        "b.csv:1: column 'angle' is missing",
    ):
        assert expected in message
    assert "a.csv:3: time_s 0 does not follow 0" in message


def test_many_faults_of_one_kind_are_summed_up(tmp_path: Path) -> None:
    text = "time_s,torque,angle\n" + "".join(f"{row},1,x\n" for row in range(100))
    message = faults_of(write(tmp_path / "r", a=text))
    assert "(and 97 more like it)" in message
    assert message.count("a.csv:") == 3


def test_a_folder_without_description_is_no_recording(tmp_path: Path) -> None:
    assert "has no recording.toml" in faults_of(tmp_path)


def test_binary_files_are_refused(tmp_path: Path) -> None:
    folder = write(tmp_path / "r")
    (folder / "a.csv").write_bytes(b"time_s,torque,angle\n0,1,\xff\xfe\n")
    assert "a.csv:2: not text" in faults_of(folder)


finite = st.floats(allow_nan=False, allow_infinity=False, width=64)


@settings(max_examples=50, deadline=None)
@given(values=st.lists(st.tuples(finite, finite), min_size=1, max_size=30))
def test_what_is_written_is_read_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, values: list[tuple[float, float]]
) -> None:
    rows = "".join(f"{0.01 * index!r},{torque!r},{angle!r}\n" for index, (torque, angle) in enumerate(values))
    trial = read_recording(write(tmp_path_factory.mktemp("r"), a="time_s,torque,angle\n" + rows)).trials[0]
    np.testing.assert_array_equal(np.hstack([trial.inputs, trial.outputs]), np.array(values))


@settings(max_examples=100, deadline=None)
@given(text=st.text(alphabet='0123456789.,-eE\nnaif "torque,angle_s;#', max_size=120))
def test_no_text_is_read_as_data_it_is_not(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    folder = write(tmp_path_factory.mktemp("r"), a="time_s,torque,angle\n" + text)
    try:
        trial = read_recording(folder).trials[0]
    except RecordingError as error:
        assert "a.csv:" in str(error)
    else:
        assert np.all(np.isfinite(trial.outputs)) and np.all(np.diff(trial.time_s) > 0)


def test_a_solvers_numbers_say_where_they_come_from(tmp_path):
    (tmp_path / "a.csv").write_text("time_s,moment\n0,1\n1,2\n")
    rest = '[channels.moment]\nkind = "output"\nunit = "N m"\n[[trials]]\nfile = "a.csv"\n'
    source = 'source = { kind = "solver", program = "CalculiX", version = "2.21", mesh = "0.4 mm", load = "1 N m" }\n'
    (tmp_path / "recording.toml").write_text(source + rest)
    assert read_recording(tmp_path).source["mesh"] == "0.4 mm"
    (tmp_path / "recording.toml").write_text(source.replace(', mesh = "0.4 mm"', "") + rest)
    with pytest.raises(
        RecordingError, match=r"mesh.*is missing: what a solver gave is worth nothing without"
    ):
        read_recording(tmp_path)
