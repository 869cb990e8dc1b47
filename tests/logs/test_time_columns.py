"""Time in a column counts in the unit that its steps, its name or a person says; a doubt is asked about."""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
import robot_logs as logs
from hypothesis import given
from hypothesis import strategies as st

from labrun.errors import RequestError
from labrun.logs import ReadOptions, questions, read_log, statements

SCALES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def write(path, columns):
    rows = zip(*columns.values(), strict=True)
    text = "\n".join([",".join(columns), *(",".join(str(cell) for cell in row) for row in rows)])
    path.write_text(text + "\n")
    return path


def read(path, **options):
    (stream,) = read_log(path, ReadOptions(**options))
    return stream


@given(
    unit=st.sampled_from(["ms", "us", "ns"]),
    rate_hz=st.sampled_from([20, 50, 100, 200, 250]),
    since=st.sampled_from([0, 12, 1_700_000_000]),
    name=st.sampled_from(["time", "timestamp", "t"]),
)
def test_whole_numbers_count_what_makes_a_rate_of_a_robot(tmp_path_factory, unit, rate_hz, since, name):
    per_s = round(1 / SCALES[unit])
    stamps = [since * per_s + row * per_s // rate_hz for row in range(100)]
    path = write(tmp_path_factory.mktemp("log") / "log.csv", {name: stamps, "a": np.sin(np.arange(100))})
    stream = read(path)
    assert np.median(np.diff(stream.time_s)) == pytest.approx(1 / rate_hz, rel=0.05)
    assert not questions(stream.findings)
    assert any("Hz" in text for text in statements(stream.findings))


@given(rate_hz=st.floats(3.0, 4000.0), since=st.sampled_from([0.0, 5e3, 1.7e9]))
def test_seconds_stay_seconds(tmp_path_factory, rate_hz, since):
    stamps = since + np.arange(60) / rate_hz
    path = write(
        tmp_path_factory.mktemp("log") / "log.csv", {"time": map(repr, stamps.tolist()), "a": np.arange(60.0)}
    )
    stream = read(path)
    assert np.ptp(stream.time_s) == pytest.approx(59 / rate_hz, rel=1e-3)
    assert not stream.findings


def test_steps_of_one_are_asked_about_and_can_be_stated(tmp_path):
    path = write(tmp_path / "log.csv", {"time": range(50), "a": np.arange(50.0)})
    (question,) = questions(read(path).findings)
    assert "1 Hz if they are seconds, 1000 Hz if milliseconds" in question.text
    assert question.proposal == "--time-unit ms"
    for unit, step in (("s", 1.0), ("ms", 1e-3)):
        stream = read(path, time_unit=unit)
        assert np.diff(stream.time_s) == pytest.approx(step)
        assert not stream.findings


@pytest.mark.parametrize(
    ("name", "step", "expected"),
    [
        ("time_s", 20, "0.05 Hz if they are seconds, 50 Hz if milliseconds"),
        ("time [ms]", 0.02, "5e+04 Hz if they are milliseconds, 50 Hz if seconds"),
    ],
)
def test_a_stated_unit_that_the_steps_deny_is_asked_about(tmp_path, name, step, expected):
    path = write(tmp_path / "log.csv", {name: step * np.arange(50), "a": np.arange(50.0)})
    (question,) = questions(read(path).findings)
    assert expected in question.text


def test_a_unit_in_the_header_counts(tmp_path):
    stream = read(write(tmp_path / "log.csv", {"time [ms]": range(50), "a": np.arange(50.0)}))
    assert np.diff(stream.time_s) == pytest.approx(1e-3)
    assert not stream.findings


@pytest.mark.parametrize(
    "names", [("sec", "nanosec"), ("header.stamp.sec", "header.stamp.nanosec"), ("secs", "nsecs")]
)
def test_seconds_and_nanoseconds_in_two_columns_are_one_time(tmp_path, names):
    nanoseconds = 1_700_000_000_900_000_000 + 20_000_000 * np.arange(50)
    columns = {names[0]: nanoseconds // 10**9, names[1]: nanoseconds % 10**9, "a": np.arange(50.0)}
    stream = read(write(tmp_path / "log.csv", columns))
    assert np.diff(stream.time_s) == pytest.approx(0.02, abs=1e-6)
    assert [column.name for column in stream.columns] == ["a"]


@pytest.mark.parametrize("zone", [None, UTC, timezone(timedelta(hours=2))])
def test_dates_with_and_without_zone_are_time(tmp_path, zone):
    start = datetime(2026, 3, 1, 23, 59, 59, tzinfo=zone)
    cells = [(start + timedelta(milliseconds=20 * row)).isoformat() for row in range(80)]
    stream = read(write(tmp_path / "log.csv", {"timestamp": cells, "a": np.arange(80.0)}))
    assert np.diff(stream.time_s) == pytest.approx(0.02, abs=1e-5)
    message = " ".join(statements(stream.findings))
    assert ("with their zone" in message) == (zone is not None)


def test_dates_of_which_some_have_a_zone_are_asked_about(tmp_path):
    cells = [f"2026-03-01T10:00:{row:02d}{'Z' if row % 2 else ''}" for row in range(40)]
    assert questions(read(write(tmp_path / "log.csv", {"time": cells, "a": np.arange(40.0)})).findings)


def test_times_of_day_go_on_over_midnight(tmp_path):
    start = datetime(2026, 3, 1, 23, 59, 59)
    moments = [start + timedelta(milliseconds=20 * row) for row in range(80)]
    columns = {
        "Date": [str(moment.date()) for moment in moments],
        "Time": [moment.time() for moment in moments],
    }
    stream = read(write(tmp_path / "log.csv", columns | {"a": np.arange(80.0)}))
    assert np.diff(stream.time_s) == pytest.approx(0.02, abs=1e-5)
    assert any("times of day" in text for text in statements(stream.findings))


def test_a_time_that_is_not_read_is_named_with_its_cell(tmp_path):
    path = write(tmp_path / "log.csv", {"time": ["1.3.2026 10:00:00"] * 40, "a": np.arange(40.0)})
    with pytest.raises(RequestError, match=r"no number in time \('1.3.2026 10:00:00'\)"):
        read(path)


def test_a_column_in_seconds_is_time_in_any_language(tmp_path):
    stream = read(write(tmp_path / "log.csv", {"Zeit [s]": 0.02 * np.arange(40), "a": np.arange(40.0)}))
    assert np.diff(stream.time_s) == pytest.approx(0.02)
    assert [column.name for column in stream.columns] == ["a"]


def test_time_that_starts_anew_begins_an_episode(tmp_path):
    time_s = np.concatenate([0.01 * np.arange(count) for count in (60, 90, 50)])
    stream = read(write(tmp_path / "log.csv", {"time_s": time_s, "a": np.arange(200.0)}))
    assert np.bincount(stream.episode).tolist() == [60, 90, 50]
    assert "log: time starts anew 2 times, at sample 61, 151: 3 episodes" in statements(stream.findings)


def test_a_wrong_stamp_and_a_table_that_runs_backwards_begin_no_episode(tmp_path):
    time_s = 0.01 * np.arange(200)
    wrong = np.where(np.arange(200) == 100, 0.0, time_s)
    for stamps in (wrong, time_s[::-1]):
        assert read(write(tmp_path / "log.csv", {"time_s": stamps, "a": np.arange(200.0)})).episode is None


@pytest.mark.parametrize("other", ["timestamp", "sim_time", "receipt_time"])
@pytest.mark.parametrize(("rate", "asked"), [(1.0, False), (0.98, True), (1.0005, True)])
def test_two_clocks_of_one_table_are_compared(tmp_path, other, rate, asked):
    time_s = 0.01 * np.arange(500)
    columns = {"time": time_s, other: 3.0 + rate * time_s, "a": np.arange(500.0)}
    stream = read(write(tmp_path / "log.csv", columns))
    texts = [question.text for question in questions(stream.findings)]
    assert bool(texts) == asked
    if asked:
        assert f"runs at {rate:.5g} of it" in texts[0]
        assert not questions(read(tmp_path / "log.csv", times={"": other}).findings)


def test_a_column_of_time_that_is_not_there_is_refused(tmp_path):
    path = logs.write_csv(tmp_path / "log.csv", *logs.motion())
    with pytest.raises(RequestError, match="--time clock: log has no such column"):
        read_log(path, ReadOptions(times={"": "clock"}))
