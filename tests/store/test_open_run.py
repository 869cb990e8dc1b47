"""`labrun.open`: a stored run as tables."""

import subprocess
import sys

import numpy as np
import pytest
from stored_runs import new_run, outcome, samples, store, store_many

import labrun
from labrun.errors import RecordingError, RequestError
from labrun.store.folder import RunFolder

pytest.importorskip("pandas")
pytest.importorskip("xarray")

RECORDING = """\
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
condition = { release = 20 }
"""


@pytest.fixture
def folder(tmp_path) -> RunFolder:
    folder = new_run(tmp_path / "results")
    store_many(folder, 3)
    store(folder, 3, count=50, status="failed", reason="no answer", objectives={}, tare={})
    return folder


def test_importing_labrun_imports_nothing_heavy():
    heavy = ["numpy", "pandas", "xarray", "h5py", "pydantic"]
    script = f"import sys, labrun; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_table_has_a_row_a_trial_with_units(folder, tmp_path):
    run = labrun.open("fin", tmp_path / "results")
    trials = run.trials
    assert trials.index.tolist() == [0, 1, 2, 3]
    assert trials.columns[:5].tolist() == ["b", "foil", "repeat", "status", "thrust"]
    assert trials.status.tolist() == ["done", "done", "done", "failed"]
    assert trials.thrust.isna().tolist() == [False, False, False, True]
    assert trials.loc[1, "thrust"] == outcome(1).objectives["thrust"]
    assert trials.attrs["units"] == {"b": "deg"} | dict.fromkeys(
        ("started_s", "duration_s", "settle_duration_s", "period_s"), "s"
    )
    assert run.trials.query("status == 'done'").attrs["units"]["b"] == "deg"


def test_signals_of_one_trial_are_tared_and_say_so(folder):
    signals = labrun.open(folder.path).signals("wrench", trial=1)
    np.testing.assert_array_equal(signals.force_x, samples(1).values[:, 0] - 0.25)
    np.testing.assert_array_equal(signals.torque_z, samples(1).values[:, 1])
    assert signals.force_x.attrs == {"units": "N", "tare": 0.25, "tared": 1}
    assert signals.torque_z.attrs == {"units": "N m"}
    assert list(signals.indexes) == ["time_s"]
    assert signals.time_s.attrs["units"] == "s"


def test_signals_come_as_measured_when_asked_for(folder):
    raw = labrun.open(folder.path).signals("wrench", trial=1, tared=False)
    np.testing.assert_array_equal(raw.force_x, samples(1).values[:, 0])
    assert raw.force_x.attrs == {"units": "N", "tare": 0.25, "tared": 0}


@pytest.mark.parametrize("packed", [False, True], ids=["folder", "packed"])
@pytest.mark.parametrize("tared", [False, True], ids=["raw", "tared"])
def test_signals_of_the_run_are_those_of_its_trials_one_after_the_other(folder, packed, tared):
    run = labrun.open(folder.pack() if packed else folder.path)
    every = run.signals("wrench", tared=tared)
    assert every.sizes == {"sample": 650}
    assert every.force_x.attrs["units"] == "N"
    for index in range(4):
        part = every.isel(sample=every.trial_index == index)
        alone = run.signals("wrench", trial=index, tared=tared)
        for name in ("force_x", "torque_z", "time_s", "device_time_s", "host_time_s"):
            np.testing.assert_array_equal(part[name], alone[name])


def test_a_channel_that_some_trials_lack_is_missing_there(tmp_path):
    from stored_runs import RATE_HZ, WRENCH, curve, motion

    from labrun.devices import Channel, Samples

    folder = new_run(tmp_path)
    store(folder, 0)
    writer = folder.writer(1)
    first = samples(1)
    writer.append("wrench", WRENCH, RATE_HZ, first)
    writer.append("probe", (Channel("angle", "rad"),), RATE_HZ, Samples(*(getattr(first, name) for name in
                  ("device_time_s", "host_time_s")), np.ones((200, 1))))  # fmt: skip
    writer.finish(outcome(1), curve(), motion())
    writer = folder.writer(2)
    writer.append("wrench", (Channel("force_x", "mN"),), RATE_HZ,
                  Samples(first.device_time_s, first.host_time_s, np.ones((200, 1))))  # fmt: skip
    writer.finish(outcome(2, tare={}), curve(), motion())
    run = labrun.open(folder.path)
    probe = run.signals("probe")
    assert set(probe.trial_index.values) == {1}
    wrench = run.signals("wrench")
    assert [wrench[name].attrs["units"] for name in wrench.data_vars] == ["N", "N m", "mN"]
    assert int(wrench["force_x_"].notnull().sum()) == 200
    assert int(wrench["force_x"].isnull().sum()) == 200


def test_what_is_not_there_is_named_with_what_is(folder, tmp_path):
    run = labrun.open(folder.path)
    with pytest.raises(RecordingError, match=r"(?s)no signals 'wrist'.*wrench"):
        run.signals("wrist", trial=0)
    with pytest.raises(RecordingError, match=r"(?s)no signals 'wrist'.*wrench"):
        run.signals("wrist")
    with pytest.raises(RecordingError, match="no trial 9"):
        run.signals("wrench", trial=9)
    with pytest.raises(RequestError, match="fine"):
        labrun.open("fine", tmp_path / "results")


def test_a_packed_file_far_from_its_folder_opens_alike(folder, tmp_path):
    before = labrun.open(folder.path).trials
    moved = tmp_path / "elsewhere.h5"
    folder.pack().rename(moved)
    run = labrun.open(moved)
    assert run.trials.equals(before)
    assert run.best is None
    assert run.path == moved


def test_a_recording_opens_like_a_run_and_nothing_is_written(tmp_path):
    folder = tmp_path / "swing"
    folder.mkdir()
    (folder / "recording.toml").write_text(RECORDING)
    (folder / "a.csv").write_text("time_s,torque,angle\n0,1,0.1\n0.1,2,0.2\n")
    run = labrun.open(folder)
    assert run.trials.release.tolist() == [20]
    assert run.devices == {"input": {"torque": "N m"}, "output": {"angle": "rad"}}
    assert run.signals("output", trial=0).angle.sel(time_s=0.1) == 0.2
    assert run.signals("input").torque.values.tolist() == [1, 2]
    assert "swing" in repr(run)
    with pytest.raises(RecordingError, match="no experiment file"):
        _ = run.experiment
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a.csv", "recording.toml", "swing"]


def test_the_repr_says_what_there_is(folder):
    text = repr(labrun.open(folder.path))
    assert "4: 3 done, 1 failed" in text
    assert "b (deg), foil" in text
    assert "wrench: force_x (N), torque_z (N m)" in text
    assert str(folder.path) in text


def test_a_library_that_is_missing_is_named_with_the_line_that_installs_it(folder, monkeypatch):
    run = labrun.open(folder.path)
    for library in ("pandas", "xarray"):
        monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(RequestError, match=r"pip install 'labrun\[data\]'"):
        _ = run.trials
    with pytest.raises(RequestError, match=r"pip install 'labrun\[data\]'"):
        run.signals("wrench", trial=0)
