"""A robot of two joints, what it was told and did, and the same in every kind of log, written by the real libraries."""

import csv
import json
from pathlib import Path

import numpy as np

ARM = """
<mujoco model="arm"><compiler angle="radian"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.5"/>
<inertial pos="0 0 -.1" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>
<body name="fore" pos="0 0 -.2"><joint name="elbow" axis="0 1 0" range="-2 2" damping="0.3"/>
<inertial pos="0 0 -.1" mass="0.2" diaginertia="5e-4 5e-4 5e-4"/></body></body></worldbody>
<actuator><position joint="shoulder" kp="20"/><position joint="elbow" kp="10"/></actuator></mujoco>
"""
JOINTS = ("shoulder", "elbow")
RATE_HZ = 100.0


def motion(moves=3, seed=1):
    """Return times (s), goals and measured angles (rad) of some moves there and back, with a rest before each."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0, 4.0 * moves, 1 / RATE_HZ)
    phase = time_s % 4.0
    envelope = np.clip((phase - 1.0) / 2.0, 0, 1)
    shape = np.sin(np.pi * envelope) ** 2 * np.where(phase < 3.0, 1.0, 0.0)
    goals = np.column_stack([0.8 * shape, -0.5 * shape])
    angles = np.column_stack([np.convolve(goal, np.ones(5) / 5)[: len(time_s)] for goal in goals.T])
    return time_s, goals, angles + 1e-3 * rng.standard_normal(angles.shape)


def write_csv(path, time_s, goals, angles, names=None):
    names = names or ["time_s", "shoulder_cmd", "elbow_cmd", "shoulder_pos", "elbow_pos"]
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(names)
        rows.writerows(np.column_stack([time_s, goals, angles]).tolist())
    return path


def write_npz(path, time_s, goals, angles):
    np.savez(path, time=time_s, qpos=angles, ctrl=goals)
    return path


def write_h5(path, time_s, goals, angles):
    import h5py

    with h5py.File(path, "w") as file:
        file["time"], file["observations/qpos"], file["action"] = time_s, angles, goals
    return path


def write_lerobot(
    folder, goals, angles, *, scale=1.0, names=JOINTS, episodes=3, version=2, lengths=None, robot_type=None
):
    """Write the layout of LeRobot's datasets: meta/info.json and a file an episode; since version 3 one of several."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    feature = {"dtype": "float32", "shape": [len(names)], "names": [f"{name}.pos" for name in names]}
    info = {
        "codebase_version": f"v{version}.0",
        "fps": RATE_HZ,
        "features": {"observation.state": feature, "action": feature},
    }
    if robot_type:
        info["robot_type"] = robot_type
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    tables, chunk = [], folder / "data" / "chunk-000"
    parts = np.array_split(np.arange(len(goals)), episodes if lengths is None else np.cumsum(lengths)[:-1])
    for episode, rows in enumerate(parts):
        table = pa.table({
            "observation.state": (scale * angles[rows]).tolist(),
            "action": (scale * goals[rows]).tolist(),
            "timestamp": (np.arange(len(rows)) / RATE_HZ).tolist(),
            "episode_index": [episode] * len(rows),
            "frame_index": list(range(len(rows))),
        })  # fmt: skip
        tables.append(table)
    if version == 2:
        for episode, table in enumerate(tables):
            pq.write_table(table, chunk / f"episode_{episode:06d}.parquet")
    else:
        pq.write_table(pa.concat_tables(tables[:2]), chunk / "file-000.parquet")
        pq.write_table(pa.concat_tables(tables[2:]), chunk / "file-001.parquet")
        message = pa.table({"episode_index": range(len(tables)), "length": [len(table) for table in tables]})
        (folder / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
        pq.write_table(message, folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    return folder


def write_bag(path, time_s, goals, angles, *, storage="mcap", clock_s=0.0, named_goals=True, names=JOINTS):
    """Write a rosbag2 folder (or, with storage ``ros1``, a .bag): joint states, and goals 5 ms before."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    ros1 = storage == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    zero = 1_700_000_000 * 10**9
    types = store.types

    def stamp(when_s):
        whole = zero + round(when_s * 1e9)
        return types["builtin_interfaces/msg/Time"](sec=whole // 10**9, nanosec=whole % 10**9)

    def header(when_s):
        more = {"seq": 0} if ros1 else {}
        return types["std_msgs/msg/Header"](stamp=stamp(when_s), frame_id="", **more)

    def states(row):
        return types["sensor_msgs/msg/JointState"](
            header=header(time_s[row] + clock_s), name=list(names), position=np.array(angles[row], dtype=float),
            velocity=np.array([]), effort=np.array([]),
        )  # fmt: skip

    def goal_message(row):
        goal = np.array(goals[row], dtype=float)
        if named_goals:
            return types["sensor_msgs/msg/JointState"](
                header=header(time_s[row] + clock_s - 0.005), name=list(names), position=goal, velocity=np.array([]),
                effort=np.array([]),
            )  # fmt: skip
        layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        return types["std_msgs/msg/Float64MultiArray"](layout=layout, data=goal)

    goal_type = "sensor_msgs/msg/JointState" if named_goals else "std_msgs/msg/Float64MultiArray"
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    if ros1:
        from rosbags.rosbag1 import Writer as Writer1

        writer = Writer1(path)
    else:
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        writer = Writer(path, version=9, storage_plugin=plugin)
    with writer:
        state = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        goal = writer.add_connection("/goal_command", goal_type, typestore=store)
        for row, when_s in enumerate(time_s):
            received = zero + round(when_s * 1e9) + 2_000_000
            writer.write(goal, received - 5_000_000, serialize(goal_message(row), goal_type))
            writer.write(state, received, serialize(states(row), "sensor_msgs/msg/JointState"))
    return path


def resident(*, afresh=False):
    """Return the most memory that this process has had, bytes; `afresh`: from now on."""
    if afresh:
        Path("/proc/self/clear_refs").write_text("5")
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
