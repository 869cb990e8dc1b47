"""No file, however damaged or lying, crashes a reader or takes memory that it does not have: a clear error or a log."""

import struct
import zipfile

import numpy as np
import pytest
import robot_logs as logs
import test_log_formats as formats
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labrun.errors import LabrunError
from labrun.logs import ReadOptions, read_log

SHORT = tuple(values[:60] for values in logs.motion(moves=1))
CELLS = ("0", "1.5", "-3", "nan", "inf", "", "x", "1e999", "9" * 400)
ENOUGH_BYTES = 48_000_000
"""What a reader and its library may take for a small file, whatever it claims."""


def write_mat(path):
    from scipy.io import savemat

    savemat(path, {"t": SHORT[0], "qpos": SHORT[2]}, do_compression=True)
    return path


def write_parquet(path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({"time": SHORT[0], "a": SHORT[2][:, 0]}), path)
    return path


def write_pt(path):
    path.write_bytes(formats.torch_bytes({"time": SHORT[0], "qpos": SHORT[2]}))
    return path


def write_ulg(path):
    rows = [(1000 + 4000 * k, [np.sin(k)]) for k in range(60)]
    return formats.write_ulog(path, {"encoder": ([("angle", 1)], rows)})


def write_storage(folder, storage, pattern):
    made = logs.write_bag(folder, *SHORT, storage=storage)
    return made if pattern is None else next(made.glob(pattern))


WRITERS = {
    "log.csv": lambda folder: logs.write_csv(folder / "log.csv", *SHORT),
    "log.npz": lambda folder: logs.write_npz(folder / "log.npz", *SHORT),
    "log.h5": lambda folder: logs.write_h5(folder / "log.h5", *SHORT),
    "log.mat": lambda folder: write_mat(folder / "log.mat"),
    "log.pt": lambda folder: write_pt(folder / "log.pt"),
    "log.parquet": lambda folder: write_parquet(folder / "log.parquet"),
    "log.ulg": lambda folder: write_ulg(folder / "log.ulg"),
    "log.mcap": lambda folder: write_storage(folder / "m", "mcap", "*.mcap"),
    "log.db3": lambda folder: write_storage(folder / "d", "sqlite", "*.db3"),
    "log.bag": lambda folder: write_storage(folder / "log.bag", "ros1", None),
}
NEEDS = {
    "log.h5": "h5py", "log.parquet": "pyarrow", "log.ulg": "pyulog", "log.mcap": "rosbags", "log.db3": "rosbags",
    "log.bag": "rosbags",
}  # fmt: skip


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Return the bytes of a small sound log of a format, written once."""
    made = {}

    def of(name):
        if name in NEEDS:
            pytest.importorskip(NEEDS[name])
        if name not in made:
            made[name] = WRITERS[name](tmp_path_factory.mktemp("sound")).read_bytes()
        return made[name]

    return of


def read_or_refuse(path):
    """Read a log; return whether it was one. Any error but ours fails the test."""
    before = logs.resident(afresh=True)
    try:
        read_log(path, ReadOptions(100.0))
    except LabrunError as error:
        assert path.stem in str(error)
        return False
    finally:
        assert logs.resident() - before < 3 * path.stat().st_size + ENOUGH_BYTES
    return True


@pytest.mark.parametrize("name", WRITERS)
@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_file_is_refused_or_read(tmp_path, sound, name, data):
    content = bytearray(sound(name))
    kind = data.draw(st.sampled_from(["cut", "bytes", "ones", "zeros", "twice"]))
    index = data.draw(st.integers(0, len(content) - 1))
    if kind == "cut":
        del content[index:]
    elif kind == "bytes":
        for byte in data.draw(st.lists(st.integers(0, 255), min_size=1, max_size=8)):
            content[(index + 37 * byte) % len(content)] = byte
    elif kind == "twice":
        content[index:index] = content[:index]
    else:
        length = data.draw(st.integers(1, 16))
        content[index : index + length] = (b"\xff" if kind == "ones" else b"\0") * length
    path = tmp_path / name
    path.write_bytes(content)
    read_or_refuse(path)


@pytest.mark.parametrize("name", WRITERS)
def test_a_sound_file_is_read_and_a_file_of_another_kind_is_refused(tmp_path, sound, name):
    path = tmp_path / name
    path.write_bytes(sound(name))
    assert read_or_refuse(path)
    path.write_bytes(b"\x89nonsense" * 50)
    assert not read_or_refuse(path)
    path.write_bytes(b"")
    assert not read_or_refuse(path)


def claim_npy(path):
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1250000000,), }".ljust(117) + b"\n"
    path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(80))


def claim_npz(path):
    claim_npy(path.with_suffix(".npy"))
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(path.with_suffix(".npy"), "qpos.npy")


def claim_unpacked(path):
    """Write an archive whose packed array claims to unpack to four billion bytes."""
    claim_npy(path.with_suffix(".npy"))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(path.with_suffix(".npy"), "qpos.npy")
    content, size = path.read_bytes(), struct.pack("<I", path.with_suffix(".npy").stat().st_size)
    path.write_bytes(content.replace(size, struct.pack("<I", 0xF0000000)))


def claim_h5(path):
    """Write data sets without storage; those of one byte a number take eight times as much in memory."""
    h5py = pytest.importorskip("h5py")
    long, kind = (1_250_000_000, "f8") if path.stem == "log" else (100_000_000, "i1")
    with h5py.File(path, "w") as file:
        file["time"] = np.arange(10.0)
        file.create_dataset("qpos", shape=(long,), dtype=kind, chunks=(1000,))


def claim_mat(path):
    path.write_bytes(struct.pack("<5i", 0, 1, 1_250_000_000, 0, 2) + b"q\0" + bytes(64))


def claim_ulg(path):
    pytest.importorskip("pyulog")
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    layout = b"a:uint64_t timestamp;float[2000000000] x;"
    path.write_bytes(
        head + struct.pack("<HB", len(layout), ord("F")) + layout + b"\x03\x00A\0\0\0a" + bytes(100)
    )


def claim_parquet(path):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    # run lengths hold forty million zeros in a few bytes
    pq.write_table(pa.table({"time": pa.array(np.zeros(40_000_000, dtype=np.int8))}), path)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("log.npy", claim_npy), ("log.npz", claim_npz), ("packed.npz", claim_unpacked), ("log.h5", claim_h5),
        ("bytes.h5", claim_h5),
        ("log.mat", claim_mat), ("log.ulg", claim_ulg), ("log.parquet", claim_parquet),
    ],
)  # fmt: skip
def test_a_file_that_claims_gigabytes_is_refused_before_they_are_taken(tmp_path, name, write):
    write(tmp_path / name)
    assert not read_or_refuse(tmp_path / name)


@given(
    table=st.lists(
        st.lists(st.sampled_from(CELLS), min_size=3, max_size=3), min_size=1, max_size=30,
    )
)  # fmt: skip
def test_no_cell_of_a_table_crashes_the_reader(tmp_path_factory, table):
    path = tmp_path_factory.mktemp("log") / "log.csv"
    path.write_text("time,a,b\n" + "\n".join(",".join(row) for row in table) + "\n")
    read_or_refuse(path)
