"""A trial's bytes from a template are those that HDF5 would have written."""

from dataclasses import replace

import numpy as np
import pytest
import stored_runs
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.errors import StoreError
from labrun.store import layout
from labrun.store.hdf5 import Column, Table
from labrun.store.reading import open_run
from labrun.store.sources import TrialSources
from labrun.store.trial_image import Content, Templates

numbers = st.floats() | st.sampled_from([0.0, -0.0])


def content(index, values, *, tare=0.25, count=30, unit="N"):
    outcome = stored_runs.outcome(index, tare={"wrench.force_x": tare}, objectives={"thrust": values[0]})
    rng = np.random.default_rng(index)
    columns = (
        Column("time_s", "s", np.arange(count) / 100.0),
        Column("force_x", unit, rng.normal(size=count), {"tare": tare}),
    )
    curve = replace(stored_runs.curve(), spread=np.full(20, values[1]))
    tables = [
        Table("wrench", columns, {"rate_hz": 100.0, "lost": 0}),
        *layout.rest_tables(curve, stored_runs.motion()),
    ]
    return Content(layout.outcome_attributes(outcome), tuple(tables))


@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(numbers, numbers, numbers), min_size=3, max_size=5))
def test_an_image_from_a_template_is_byte_for_byte_the_one_that_hdf5_writes(trials):
    templates = Templates()
    for index, (first, second, tare) in enumerate(trials):
        trial = content(index, (first, second), tare=tare)
        expected = trial.padded().write()[0]
        assert templates.image(trial)[0] == expected
        image, places = templates.image(trial)  # its shape has come twice now, if not before
        assert image == expected
        assert places is not None


def test_what_is_read_from_the_bytes_is_what_hdf5_reads(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    for index in range(4):
        stored_runs.store(folder, index, tare={"wrench.force_x": 0.5 * index})
    files = {index: folder.path / "trials" / f"{index:06d}.h5" for index in range(4)}
    with (
        TrialSources(folder.path / "run.h5", files, folder.written) as quick,
        TrialSources(folder.path / "run.h5", files) as slow,
    ):
        for index in range(4):
            with quick.tables(index) as ours, slow.tables(index) as theirs:
                assert ours.names == theirs.names
                for name in ours.names:
                    assert ours[name].copy() == theirs[name].copy()


def test_trials_of_different_shapes_do_not_mix():
    templates = Templates()
    kinds = [{"count": 30}, {"count": 31}, {"unit": "N m"}, {"count": 0}]
    for index in range(12):
        trial = content(index, (1.0, 2.0), **kinds[index % 4])
        assert templates.image(trial)[0] == trial.padded().write()[0]


def test_an_outcome_too_long_for_an_attribute_is_written_as_before():
    trial = content(1, (1.0, 2.0))
    long = Content({**trial.attributes, "outcome": "x" * 70_000}, trial.tables)
    templates = Templates()
    for _ in range(3):
        image, places = templates.image(long)
        assert image == long.write()[0]
        assert places is None


def test_a_trial_file_changed_behind_our_back_is_not_packed_as_if_it_were_whole(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    path = folder.path / "trials" / "000003.h5"
    with folder.lock():
        stored_runs.store_many(folder, 4)
        path.write_bytes(path.read_bytes()[:1000])
        with pytest.raises(StoreError, match="truncated"):
            folder.pack()
    assert path.exists()


def test_a_run_packs_the_same_whether_or_not_this_process_wrote_it(tmp_path):
    packed = []
    for name in ("written", "opened"):
        folder = stored_runs.new_run(tmp_path / name)
        stored_runs.store_many(folder, 5)
        if name == "opened":
            folder.written.clear()
        packed.append(open_run(folder.pack().parent))
    for index in range(5):
        ours, theirs = (run.stream(index, "wrench") for run in packed)
        for field in ("time_s", "device_time_s", "host_time_s", "values"):
            np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))
        assert ours.tare == theirs.tare
