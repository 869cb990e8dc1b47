"""Every format that the table of docs/robot-logs.md names, written by the library of its makers, is read."""

import io
import pickle
import struct
import zipfile
from collections import OrderedDict

import numpy as np
import pytest
import robot_logs as logs

from labrun.app.logs import import_log
from labrun.errors import RecordingError
from labrun.logs import ReadOptions, read_log, statements
from labrun.store import read_recording


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(logs.ARM)
    return path


class FloatStorage:
    """What a pickle of PyTorch names as the type of a storage."""


class Tensor:
    """An array that is pickled as ``torch.save`` pickles a tensor; its storage goes to a file of its own."""

    def __init__(self, values, storages, transposed=False):
        self.values, self.storages, self.transposed = np.asarray(values), storages, transposed


class TorchPickler(pickle.Pickler):
    """Write what ``torch.save`` writes into data.pkl, by the format's own description."""

    def persistent_id(self, obj):
        return obj if isinstance(obj, tuple) and obj and obj[0] == "storage" else None

    def reducer_override(self, obj):
        if isinstance(obj, Tensor):
            key = str(len(obj.storages))
            stored = obj.values.T if obj.transposed else obj.values
            obj.storages[key] = np.ascontiguousarray(stored, dtype="<f4").tobytes()
            storage = ("storage", FloatStorage, key, "cpu", obj.values.size)
            strides = [stride // 4 for stride in np.ascontiguousarray(stored, dtype="<f4").strides]
            strides = tuple(strides[::-1] if obj.transposed else strides)
            return rebuild_tensor, (storage, 0, obj.values.shape, strides, False, OrderedDict())
        return NotImplemented


def rebuild_tensor(*_):
    raise AssertionError("a reader never runs what a file names")


def torch_bytes(arrays, transposed=False):
    """Return the bytes of a .pt file; names of this module are changed into those of PyTorch."""
    storages = {}
    stream = io.BytesIO()
    pickler = TorchPickler(stream, protocol=2)
    pickler.dump({name: Tensor(values, storages, transposed) for name, values in arrays.items()})
    text = stream.getvalue()
    module = __name__.encode()
    for own, theirs in (
        (b"rebuild_tensor", b"torch._utils\n_rebuild_tensor_v2"),
        (b"FloatStorage", b"torch\nFloatStorage"),
    ):
        text = text.replace(b"c" + module + b"\n" + own + b"\n", b"c" + theirs + b"\n")
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("log/data.pkl", text)
        archive.writestr("log/version", "3\n")
        for key, data in storages.items():
            archive.writestr(f"log/data/{key}", data)
    return out.getvalue()


@pytest.mark.parametrize("transposed", [False, True])
def test_tensors_are_read_without_pytorch(tmp_path, arm, transposed):
    time_s, goals, angles = logs.motion()
    tensors = {"ctrl": goals, "qpos": angles}
    path = tmp_path / "log.pt"
    path.write_bytes(torch_bytes({"time": time_s[:, None] if transposed else time_s, **tensors}, transposed))
    recording = read_recording(import_log(path, arm, tmp_path / "recording").folder)
    outputs = np.concatenate([trial.outputs for trial in recording.trials])
    assert len(recording.trials) == 3
    assert outputs.max(axis=0) == pytest.approx(angles.max(axis=0), abs=1e-6)


def test_what_pytorch_saves_is_read(tmp_path):
    torch = pytest.importorskip("torch")
    time_s, _, angles = logs.motion(moves=1)
    saved = {
        "time": torch.tensor(time_s),
        "qpos": torch.nn.Parameter(torch.tensor(angles)),
        "device": torch.device("cpu"),
    }
    torch.save(saved, tmp_path / "log.pt")
    (stream,) = read_log(tmp_path / "log.pt")
    assert np.column_stack([column.values for column in stream.columns]) == pytest.approx(angles)


class Harmful:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (self.path, "w")


def test_a_file_of_tensors_never_runs_what_it_names(tmp_path):
    target = tmp_path / "harmed"
    stream = io.BytesIO()
    pickle.dump({"qpos": Harmful(str(target))}, stream, protocol=2)
    with zipfile.ZipFile(tmp_path / "log.pt", "w") as archive:
        archive.writestr("log/data.pkl", stream.getvalue())
    with pytest.raises(
        RecordingError, match=r"names io.open, which is not a tensor of numbers, and was not run"
    ):
        read_log(tmp_path / "log.pt", ReadOptions(100.0))
    assert not target.exists()


@pytest.mark.parametrize(
    ("shape", "stride", "offset"),
    [((10**9,), (1,), 0), ((10**9,), (0,), 0), ((2,), (1,), 7), ((2,), (-1,), 1)],
)
def test_a_tensor_larger_than_its_storage_is_refused(tmp_path, shape, stride, offset):
    stream = io.BytesIO()
    pickler = TorchPickler(stream, protocol=2)

    class Lying:
        def __reduce__(self):
            return rebuild_tensor, (
                ("storage", FloatStorage, "0", "cpu", 8),
                offset,
                shape,
                stride,
                False,
                None,
            )

    pickler.dump({"qpos": Lying()})
    module = __name__.encode()
    text = stream.getvalue().replace(
        b"c" + module + b"\nrebuild_tensor\n", b"ctorch._utils\n_rebuild_tensor_v2\n"
    )
    text = text.replace(b"c" + module + b"\nFloatStorage\n", b"ctorch\nFloatStorage\n")
    with zipfile.ZipFile(tmp_path / "log.pt", "w") as archive:
        archive.writestr("log/data.pkl", text)
        archive.writestr("log/data/0", bytes(32))
    with pytest.raises(RecordingError, match="cannot be read as tensors"):
        read_log(tmp_path / "log.pt", ReadOptions(100.0))


@pytest.mark.parametrize("version", ["5", "4"])
def test_matrices_of_matlab_are_read(tmp_path, arm, version):
    from scipy.io import savemat

    time_s, goals, angles = logs.motion()
    path = tmp_path / "log.mat"
    savemat(path, {"t": time_s[:, None], "ctrl": goals, "qpos": angles}, format=version)
    recording = read_recording(import_log(path, arm, tmp_path / "recording").folder)
    assert len(recording.trials) == 3


def test_structures_of_matlab_and_simulink_are_read_with_their_time(tmp_path):
    from scipy.io import savemat

    time_s, goals, angles = logs.motion()
    signals = [{"values": goals, "label": "ctrl"}, {"values": angles, "label": "qpos"}]
    savemat(tmp_path / "log.mat", {"out": {"time": time_s, "signals": signals}})
    (stream,) = read_log(tmp_path / "log.mat")
    assert len(stream.columns) == 4
    assert stream.time_s == pytest.approx(time_s)


def test_a_matlab_file_of_version_7_3_is_upright(tmp_path):
    h5py = pytest.importorskip("h5py")
    time_s, goals, angles = logs.motion()
    with h5py.File(tmp_path / "log.mat", "w", userblock_size=512) as file:
        for name, values in (("t", time_s[None]), ("ctrl", goals.T), ("qpos", angles.T)):
            file[name] = values
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with (tmp_path / "log.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    (stream,) = read_log(tmp_path / "log.mat")
    assert {column.name: column.values.max() for column in stream.columns}["qpos[0]"] == angles[:, 0].max()


def write_ulog(path, topics):
    """Write a ULog as PX4's own description has it: header, formats, subscriptions, data."""

    def message(kind, content):
        return struct.pack("<HB", len(content), ord(kind)) + content

    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000)
    data += message("B", bytes(40))
    for name, (fields, _) in topics.items():
        layout = "uint64_t timestamp;" + "".join(f"float[{width}] {field};" for field, width in fields)
        data += message("F", f"{name}:{layout}".encode())
    for number, name in enumerate(topics):
        data += message("A", struct.pack("<BH", 0, number) + name.encode())
    rows = [
        (stamp, struct.pack("<HQ", number, stamp) + np.asarray(values, dtype="<f4").tobytes())
        for number, (_, rows) in enumerate(topics.values())
        for stamp, values in rows
    ]
    for _, content in sorted(rows, key=lambda row: row[0]):
        data += message("D", content)
    path.write_bytes(data)
    return path


def test_topics_of_px4_are_read_with_their_own_stamps(tmp_path):
    pytest.importorskip("pyulog")
    rows = [(1000 + 4000 * k, [np.sin(0.1 * k), 0.5, 0.0, 0.0]) for k in range(200)]
    slow = [(1000 + 20_000 * k, [0.1 * k]) for k in range(40)]
    topics = {"actuator_controls": ([("control", 4)], rows), "wheel_encoders": ([("wheel_angle", 1)], slow)}
    streams = {stream.name: stream for stream in read_log(write_ulog(tmp_path / "log.ulg", topics))}
    fast = streams["/actuator_controls"]
    assert np.diff(fast.time_s) == pytest.approx(0.004)
    assert np.diff(streams["/wheel_encoders"].time_s) == pytest.approx(0.02)
    first = next(column for column in fast.columns if column.index == 0)
    assert first.role == "command"
    assert first.values == pytest.approx(np.sin(0.1 * np.arange(200)), abs=1e-6)


def test_units_that_an_hdf5_file_states_are_taken(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["time"] = 0.01 * np.arange(100)
        file["shoulder"] = np.arange(100.0)
        file["shoulder"].attrs["units"] = "deg"
    (stream,) = read_log(tmp_path / "log.h5")
    assert stream.columns[0].unit == "deg"


def test_the_length_that_a_lerobot_data_set_states_is_compared(tmp_path):
    pytest.importorskip("pyarrow")
    import json

    _, goals, angles = logs.motion()
    folder = logs.write_lerobot(tmp_path / "set", goals, angles)
    file = folder / "meta" / "info.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "total_episodes": 5, "total_frames": 2000}))
    messages = [text for stream in read_log(folder) for text in statements(stream.findings)]
    assert "set: meta/info.json states total_episodes 5, and 3 were found" in messages
    assert "set: meta/info.json states total_frames 2000, and 1200 were found" in messages


def test_parquet_with_dates_and_single_array(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    stamps = 1_700_000_000_000_000 + 20_000 * np.arange(100)
    table = pyarrow.table(
        {"timestamp": pyarrow.array(stamps, pyarrow.timestamp("us", "UTC")), "a": np.arange(100.0)}
    )
    parquet.write_table(table, tmp_path / "log.parquet")
    (stream,) = read_log(tmp_path / "log.parquet")
    assert np.diff(stream.time_s) == pytest.approx(0.02)
    np.save(tmp_path / "log.npy", np.zeros((50, 3)))
    (stream,) = read_log(tmp_path / "log.npy", ReadOptions(50.0))
    assert len(stream.columns) == 3


@pytest.mark.parametrize("cells", [True, False])
def test_structures_in_a_list_are_episodes_and_those_of_joints_are_not(tmp_path, cells):
    from scipy.io import savemat

    time_s, _, angles = logs.motion(moves=1)
    parts = [{"t": time_s[:80], "pos": angles[:80, joint]} for joint in range(2)]
    savemat(tmp_path / "log.mat", {"trials" if cells else "joint": np.array(parts, dtype=object)})
    streams = read_log(tmp_path / "log.mat")
    names = [column.name for stream in streams for column in stream.columns]
    assert names == (["trials/pos"] if cells else ["joint/0/pos", "joint/1/pos"])
    assert (streams[0].episode is not None) == cells


def test_a_group_for_each_joint_names_it(tmp_path, arm):
    h5py = pytest.importorskip("h5py")
    time_s, goals, angles = logs.motion()
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["time"] = time_s
        for index, joint in enumerate(logs.JOINTS):
            file[f"robot/{joint}/position"], file[f"robot/{joint}/command"] = (
                angles[:, index],
                goals[:, index],
            )
    result = import_log(tmp_path / "log.h5", arm, tmp_path / "recording")
    assert dict(result.channels)["elbow"] == "robot/elbow/position"


def test_objects_of_an_archive_are_left_out_by_name(tmp_path):
    time_s, _, angles = logs.motion(moves=1)
    np.savez(tmp_path / "log.npz", time=time_s, qpos=angles, meta=np.array({"robot": "arm"}, dtype=object))
    (stream,) = read_log(tmp_path / "log.npz")
    assert "log.npz: meta are objects of Python, which are not read; left out" in statements(stream.findings)
