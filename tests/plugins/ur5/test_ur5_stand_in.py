import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.simulated.bench import Carriage as Towed
from labrun_plugins.ur5.motion import Line
from labrun_plugins.ur5.settings import Ur5Settings, channels_of
from scipy.spatial.transform import Rotation

from labrun import registry
from labrun.devices import DeviceContext

TABLE = {
    "host": "192.168.1.2",
    "limits": {"travel_m": [0.0, 0.7], "speed_m_s": 0.1},
    "origin_m": [0.2, -0.3, 0.25],
    "direction": [0.0, 3.0, 4.0],
    "orientation_rad": [0.0, 3.14, 0.0],
    "watchdog_ms": 200,
    "tool_channels": True,
}


class Clock:
    poll_s = 0.1

    def __init__(self):
        self.now_s = 100.0

    def now(self):
        return self.now_s

    def sleep(self, duration_s):
        self.now_s += duration_s


class Tank:
    """A carriage and nothing else."""

    def __init__(self):
        self.signals = {"position": "m"}
        self.joints = ()
        self.carriage = Towed()

    def tow(self, from_m, to_m, speed_m_s, start_s):
        self.carriage.move(from_m, to_m, speed_m_s, start_s)

    def observe(self, signals, time_s):
        assert np.all(np.diff(time_s) >= 0), "a scene is asked in the order of time"
        return self.carriage.motion(time_s)[0][:, None]


def stand_in(**keys):
    make = registry.load("labrun.devices", "simulated-ur5")
    clock = Clock()
    arm = make(
        "arm", make.Settings(**{**TABLE, **keys}), DeviceContext(clock, np.random.default_rng(3), Tank())
    )
    arm.open()
    return arm, clock


def test_one_table_serves_driver_and_stand_in():
    arm, _ = stand_in()
    settings = Ur5Settings.model_validate(TABLE)
    assert arm.channels == channels_of(settings)
    plain = Ur5Settings(host="h")
    assert [channel.name for channel in channels_of(plain)] == ["position"]
    assert (plain.rtde_port, plain.dashboard_port, plain.script_port, plain.primary_port) == (
        30004, 29999, 30002, 30001,
    )  # fmt: skip
    with pytest.raises(ValueError, match="leads nowhere"):
        Ur5Settings(host="h", direction=(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="finite"):
        Ur5Settings(host="h", origin_m=(0.0, float("nan"), 0.0))


def test_the_stand_ins_tool_moves_along_the_line_and_knows_when_it_cruises():
    arm, clock = stand_in()
    arm.start()
    clock.sleep(0.5)
    arm.travel(0.1, 0.05)
    for _ in range(30):
        clock.sleep(0.1)
    samples = arm.read()
    data = dict(zip([channel.name for channel in arm.channels], samples.values.T, strict=True))
    assert data["tool_x"] == pytest.approx(0.2, abs=2e-4)
    assert data["tool_y"] == pytest.approx(-0.3 + 0.6 * data["position"], abs=2e-4)
    assert data["tool_z"] == pytest.approx(0.25 + 0.8 * data["position"], abs=2e-4)
    constant = data["constant_speed"] == 1.0
    assert constant.sum() == pytest.approx(1.86 * 125, abs=3)  # 0.1 m with ramps of 0.1 s and 2.5 mm, rounded
    assert data["target_speed"][constant] == pytest.approx(0.05, rel=5e-3)
    assert data["actual_speed"][constant].mean() == pytest.approx(0.05, rel=1e-3)
    assert np.all(data["speed_scaling"] == 1.0)
    assert data["position"][-1] == pytest.approx(0.1, abs=2e-4)


def test_without_the_key_the_stand_in_measures_what_it_always_did():
    arm, clock = stand_in(tool_channels=False)
    arm.start()
    clock.sleep(1.0)
    samples = arm.read()
    assert samples.values.shape[1] == 1
    assert np.std(samples.values) == pytest.approx(2e-5, rel=0.3)


VECTOR = st.tuples(*[st.floats(-2, 2)] * 3)


@given(VECTOR, VECTOR.filter(lambda v: np.linalg.norm(v) > 1e-3), VECTOR, st.floats(-1, 1))
def test_a_position_is_found_again_in_the_pose_it_stands_for(origin, direction, turn, position_m):
    line = Line.through((*origin, *turn), direction)
    pose = np.array(line.pose(position_m))
    assert line.position_m(pose) == pytest.approx(position_m, abs=1e-9)
    assert line.beside_m(pose) == pytest.approx(0.0, abs=1e-9)
    assert line.turned_rad(pose) == pytest.approx(0.0, abs=1e-6)


@given(VECTOR, VECTOR)
def test_the_angle_between_two_orientations_is_that_of_their_rotation(first, other):
    line = Line.through((0, 0, 0, *first), (1, 0, 0))
    expected = (Rotation.from_rotvec(first).inv() * Rotation.from_rotvec(other)).magnitude()
    assert line.turned_rad(np.array([0, 0, 0, *other])) == pytest.approx(expected, abs=1e-6)
