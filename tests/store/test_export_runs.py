"""A run leaves labrun as CSV or netCDF, without loss."""

import csv
import os

import numpy as np
import pytest
import stored_runs

from labrun.errors import RequestError, StoreError
from labrun.store.export import export_run, to_csv, to_netcdf
from labrun.store.reading import open_run


@pytest.fixture
def run(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store_many(folder, 4)
    stored_runs.store(folder, 4, status="failed", reason="device wrench: no answer", objectives={})
    return open_run(folder.path)


def test_csv_has_one_row_a_trial_in_the_order_promised(run, tmp_path):
    to_csv(run, tmp_path / "trials.csv")
    with (tmp_path / "trials.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:6] == ["index", "b (deg)", "foil", "repeat", "status", "thrust"]
    assert {"started_s", "duration_s"} < set(rows[0]), "a unit that the name ends in is not repeated"
    assert {"role", "reason"} < set(rows[0])
    assert [int(row["index"]) for row in rows] == list(range(5))
    assert [float(row["b (deg)"]) for row in rows] == [0.1 * index for index in range(5)]
    assert [float(row["thrust"]) for row in rows[:4]] == [1 / (index + 3) for index in range(4)]
    assert (rows[4]["thrust"], rows[4]["status"], rows[4]["reason"]) == (
        "",
        "failed",
        "device wrench: no answer",
    )


@pytest.mark.parametrize("packed", [False, True])
def test_netcdf_opens_with_plain_xarray(run, tmp_path, packed):
    xarray = pytest.importorskip("xarray")
    if packed:
        from labrun.store.folder import RunFolder

        run = open_run(RunFolder.open(run.path).pack())
    to_netcdf(run, tmp_path / "run.nc")
    with xarray.open_dataset(tmp_path / "run.nc") as table:
        assert table.sizes == {"trial": 5}
        assert table["status"].values[4] == "failed"
    with xarray.open_dataset(tmp_path / "run.nc", group="wrench") as wrench:
        third = wrench["force_x"][wrench["trial_index"] == 2]
        np.testing.assert_array_equal(third, stored_runs.samples(2).values[:, 0])
    assert open_run(tmp_path / "run.nc").outcomes == run.outcomes


def test_without_a_name_the_export_stands_in_the_runs_folder(run):
    assert export_run(run, "csv") == run.path / f"fin-{run.identifier}.csv"
    assert export_run(run, "netcdf").suffix == ".nc"


def test_an_unknown_format_is_refused_with_the_known_ones(run):
    with pytest.raises(RequestError, match="formats: csv, netcdf"):
        export_run(run, "xlsx")


def test_a_folder_to_write_to_is_a_wrong_request(run, tmp_path):
    with pytest.raises(RequestError, match=r"is a folder; expected the file") as caught:
        export_run(run, "csv", tmp_path)
    assert run.identifier in caught.value.hint


def test_a_file_that_cannot_be_written_says_so_and_leaves_nothing(run, tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", refuse)
    with pytest.raises(StoreError, match="the run itself is untouched"):
        to_netcdf(run, tmp_path / "out" / "run.nc")
    assert list((tmp_path / "out").iterdir()) == []
