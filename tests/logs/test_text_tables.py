"""Text is read as it was written, or refused with the encoding or the row named."""

import numpy as np
import pytest
import robot_logs as logs
from hypothesis import given
from hypothesis import strategies as st
from robot_logs import resident

from labrun.errors import RecordingError
from labrun.logs import read_log, statements

ROWS = "\n".join(f"{0.01 * row:.2f},{np.sin(0.1 * row):.6f},{row}" for row in range(60))


def read(path, data, encoding="utf-8"):
    path.write_bytes(data if isinstance(data, bytes) else data.encode(encoding))
    (stream,) = read_log(path)
    return {column.name: column.values for column in stream.columns}, stream


@pytest.mark.parametrize(
    ("encoding", "name"),
    [
        ("utf-16", "UTF-16"),
        ("utf-16-le", "UTF-16-LE"),
        ("utf-16-be", "UTF-16-BE"),
        ("cp1252", "Windows-1252"),
        ("utf-8-sig", ""),
    ],
)
def test_every_encoding_gives_the_same_table_and_is_told(tmp_path, encoding, name):
    columns, stream = read(tmp_path / "log.csv", f"time,Gelenk (\N{DEGREE SIGN}),zähler\n{ROWS}\n", encoding)
    assert columns["zähler"] == pytest.approx(np.arange(60))
    assert columns["Gelenk (\N{DEGREE SIGN})"] == pytest.approx(np.sin(0.1 * np.arange(60)), abs=1e-6)
    assert name in " ".join(statements(stream.findings))


def test_the_line_that_tells_excel_the_delimiter_is_no_header(tmp_path):
    columns, _ = read(tmp_path / "log.csv", "sep=;\ntime;a,b;c\n" + ROWS.replace(",", ";"))
    assert columns["a,b"] == pytest.approx(np.sin(0.1 * np.arange(60)), abs=1e-6)


@pytest.mark.parametrize("blank", ["", "NA", "null", "nan", "-"])
def test_a_cell_that_stands_for_no_number_is_blank(tmp_path, blank):
    rows = [f"{row},{row},{row if row % 4 == 0 else blank}" for row in range(60)]
    (tmp_path / "log.csv").write_text("\n".join(["time_ms,a,b", *rows]) + "\n")
    counts = {stream.columns[0].name: len(stream.time_s) for stream in read_log(tmp_path / "log.csv")}
    assert counts == {"a": 60, "b": 15}


@given(
    delimiter=st.sampled_from([";", "\t"]),
    comma=st.booleans(),
    trailing=st.booleans(),
    quoted=st.booleans(),
    units=st.booleans(),
)
def test_a_table_is_the_same_whatever_parts_its_cells(
    tmp_path_factory, delimiter, comma, trailing, quoted, units
):
    lines = ["time,angle,count", *(["s,rad,-"] if units else []), *ROWS.splitlines()]
    cells = [line.split(",") for line in lines]
    if comma:
        cells = [[cell.replace(".", ",") for cell in row] for row in cells]
    if quoted:
        cells = [[f'"{cell}"' for cell in row] for row in cells]
    text = "\n".join(delimiter.join(row) + delimiter * trailing for row in cells)
    columns, stream = read(tmp_path_factory.mktemp("log") / "log.csv", text + "\n")
    assert columns["angle"] == pytest.approx(np.sin(0.1 * np.arange(60)), abs=1e-6)
    assert stream.time_s == pytest.approx(0.01 * np.arange(60))
    assert ({column.name: column.unit for column in stream.columns}["angle"] == "rad") == units


def test_a_row_of_units_below_the_header_is_what_the_log_states(tmp_path):
    rows = "\n".join(f"{10 * row},{row}" for row in range(60))
    _, stream = read(tmp_path / "log.csv", f"time,angle\nms,[deg]\n{rows}\n")
    assert stream.columns[0].unit == "deg"
    assert np.diff(stream.time_s) == pytest.approx(0.01)
    assert "log.csv:2: read as a row of units: ms, [deg]" in statements(stream.findings)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,a\n0,1\n1,2,5\n2,3\n", r"log.csv:3: 3 cells below a header of 2"),
        (
            "time,a\n0,0,1\n0,1,2,5\n",
            r"log.csv:2: 3 cells below a header of 2\s.*decimal commas, columns must be separated by semicolons",
        ),
        (
            "time;a\n0;1.234,5\n1;2.345,5\n",
            r"log.csv:2: '1.234,5' of column 'a' has points between thousands",
        ),
        ("time,a\n0,x\n1,y\n2,3\n", r"log.csv:2: column 'a' holds 'x', and no number in 2 of 3 rows"),
        ("0,1\n1,2\n2,3\n", r"log.csv:1: numbers where the names of columns were expected"),
        ("time,a,a\n0,1,2\n", r"log.csv:1: the name 'a' stands twice"),
        ("time,a\n0,\0\n", r"a zero byte"),
    ],
)
def test_what_is_no_table_is_refused_with_its_row(tmp_path, text, message):
    with pytest.raises(RecordingError, match=message):
        read(tmp_path / "log.csv", text)


def test_a_last_line_that_was_cut_short_is_left_out_and_told(tmp_path):
    columns, stream = read(tmp_path / "log.csv", f"time,angle,count\n{ROWS}\n0.61,0")
    assert len(columns["count"]) == 60
    assert "log.csv:62: the last line has 2 of 3 cells, and is left out" in statements(stream.findings)


def test_comments_above_the_header_and_spaces_as_delimiters_are_read(tmp_path):
    text = "# made by a logger\n\ntime angle count\n" + ROWS.replace(",", "   ")
    columns, _ = read(tmp_path / "log.txt", text)
    assert columns["count"] == pytest.approx(np.arange(60))


def test_cells_without_a_number_are_counted(tmp_path):
    rows = ROWS.splitlines()
    rows[7] = "0.07,oops,7"
    _, stream = read(tmp_path / "log.csv", "time,angle,count\n" + "\n".join(rows) + "\n")
    assert "log.csv: column angle has 1 cells without a number, first 'oops' in line 9" in statements(
        stream.findings
    )


def test_a_large_table_takes_little_more_memory_than_its_numbers(tmp_path):
    time_s, goals, angles = logs.motion(moves=60)
    path = logs.write_csv(tmp_path / "log.csv", time_s, goals, angles)
    before = resident(afresh=True)
    read_log(path)
    assert resident() - before < 3 * path.stat().st_size + 8e6
