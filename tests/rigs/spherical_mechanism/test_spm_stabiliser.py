"""The stabiliser's bench: a base that tilts at random, the mechanism, its laminate, and a loop that levels it."""

import numpy as np
import pytest
from labrun_plugins.rigs.spherical_mechanism import kinematics
from labrun_plugins.rigs.spherical_mechanism.scene import SpmStabiliser
from scipy.spatial.transform import Rotation
from simulated_bench import HandClock, device, line

from labrun import registry
from labrun.devices import Trajectory
from labrun.effects import effects
from labrun.errors import SpecError

STEP_S = 0.02


def _scene(seed=0, **keys):
    return SpmStabiliser(keys, np.random.default_rng(seed))


def _seen(scene, time_s, *signals):
    return scene.observe(signals, time_s)


def _turn(scene, body, time_s):
    return Rotation.from_quat(_seen(scene, time_s, *(f"{body}_{part}" for part in ("qx", "qy", "qz", "qw"))))


def _long_record(**keys):
    scene = _scene(**keys)
    blocks = [np.arange(0, 100, 0.02) + start for start in range(0, 1000, 100)]
    return np.concatenate([_seen(scene, block, "base_x", "base_y") for block in blocks])


@pytest.mark.parametrize(("tilt_deg", "bandwidth_hz"), [(6.0, 0.5), (3.0, 0.8)])
def test_the_base_tilts_with_the_rms_and_the_bandwidth_asked_for(tilt_deg, bandwidth_hz):
    tilt = np.degrees(_long_record(base_tilt_deg=tilt_deg, base_bandwidth_hz=bandwidth_hz))
    np.testing.assert_allclose(tilt.std(axis=0), tilt_deg, rtol=0.08)
    assert abs(np.corrcoef(tilt.T)[0, 1]) < 0.15
    power = np.mean(np.abs(np.fft.rfft(tilt, axis=0)) ** 2, axis=1)
    hz = np.fft.rfftfreq(len(tilt), 0.02)

    # A Butterworth filter of fourth order: power 1 / (1 + (f / f_c)^8).
    def share(below_hz):
        weight = 1 / (1 + (hz / bandwidth_hz) ** 8)
        return power[hz < below_hz].sum() / power.sum(), weight[hz < below_hz].sum() / weight.sum()

    for factor in (0.5, 1.0, 1.4):
        assert share(factor * bandwidth_hz)[0] == pytest.approx(share(factor * bandwidth_hz)[1], abs=0.05)
    assert share(1.4 * bandwidth_hz)[0] > 0.97


def test_without_noise_nothing_moves_and_the_mechanism_stands_level():
    scene = _scene(noise=0)
    values = _seen(scene, np.arange(0, 5, 0.1), "base_tilt", "end_effector_tilt", "base_wx", "theta_1")
    np.testing.assert_array_equal(values, 0.0)


def test_the_end_effector_stands_as_the_mechanisms_kinematics_say():
    scene = _scene(seed=4)
    _seen(scene, np.array([0.0]), "base_x")
    for joint, angle in (("servo_1", 30.0), ("servo_2", -20.0)):
        scene.drive(joint, line(joint, [0.0, angle], [0.0, 1.0]), 0.1)
    time_s = np.arange(0.5, 6.0, 0.005)
    theta = _seen(scene, time_s, "theta_1", "theta_2")
    relative = _turn(scene, "base", time_s).inv() * _turn(scene, "end_effector", time_s)
    np.testing.assert_allclose(relative.as_matrix(), kinematics.rotation(theta[:, 0], theta[:, 1]), atol=1e-9)
    lean = _seen(scene, time_s, "base_x", "base_y")
    expected = Rotation.from_euler("YX", lean[:, ::-1])
    np.testing.assert_allclose(_turn(scene, "base", time_s).as_matrix(), expected.as_matrix(), atol=1e-12)
    for body in ("base", "end_effector"):
        normal = _turn(scene, body, time_s).as_matrix()[:, :, 2]
        np.testing.assert_allclose(
            _seen(scene, time_s, f"{body}_tilt")[:, 0], np.arccos(normal[:, 2]), atol=1e-7
        )


@pytest.mark.parametrize("body", ["base", "end_effector"])
def test_angular_velocity_is_the_derivative_of_the_orientation(body):
    scene = _scene(seed=2)
    time_s = np.arange(1, 1000) * 0.005 + 1.0
    turn = _turn(scene, body, time_s)
    rate = _seen(scene, time_s[1:], *(f"{body}_w{axis}" for axis in "xyz"))
    expected = (turn[:-1].inv() * turn[1:]).as_rotvec() / 0.005
    np.testing.assert_allclose(rate, expected, atol=1e-6)


def test_the_laminate_lags_behind_the_servo_as_a_second_order_system():
    """Against scipy's solution of the same equation, linearised: k' = k - G, sag included."""
    from scipy.signal import StateSpace, lsim

    scene = _scene(noise=0)
    _seen(scene, np.array([0.0]), "theta_1")
    scene.drive("servo_1", line("servo_1", [0.0, 3.0], [0.0, 0.05]), 0.1)
    time_s = np.arange(0.0, 1.0, 0.005)
    theta, servo = _seen(scene, time_s, "theta_1", "servo_1").T
    k, b, inertia, gravity = 0.114, 6e-4, 2e-5, 6e-3
    system = StateSpace(
        [[0, 1], [-(k - gravity) / inertia, -b / inertia]], [[0], [k / inertia]], [[1, 0]], [[0]]
    )
    _, expected, _ = lsim(system, servo, time_s)
    np.testing.assert_allclose(theta, expected, atol=2e-4 * servo.max() + 1e-5)
    assert theta[-1] / servo[-1] == pytest.approx(k / (k - gravity), rel=1e-3)


def test_a_leaning_end_effector_sags_further_to_the_side_it_leans_to():
    stiff, soft = _scene(seed=3, parameters={"gravity_torque": -1.0}), _scene(seed=3)
    time_s = np.arange(0.0, 60.0, 0.05)
    sag = _seen(soft, time_s, "end_effector_tilt") - _seen(stiff, time_s, "end_effector_tilt")
    lean = _seen(stiff, time_s, "end_effector_tilt")
    assert np.corrcoef(sag[:, 0], lean[:, 0])[0, 1] > 0.98
    assert np.polyfit(lean[:, 0], sag[:, 0], 1)[0] == pytest.approx(0.055, rel=0.1)


def test_links_stop_at_85_degrees():
    scene = _scene(noise=0)
    _seen(scene, np.array([0.0]), "theta_1")
    scene.drive("servo_2", line("servo_2", [0.0, 120.0], [0.0, 1.0]), 0.1)
    tilt = _seen(scene, np.arange(0.0, 5.0, 0.01), "end_effector_tilt")
    assert np.degrees(tilt.max()) == pytest.approx(85.0)


def test_the_same_seed_shakes_the_same_way_and_another_seed_another_way():
    time_s = np.arange(0.0, 20.0, 0.01)
    first, again, other = (_seen(_scene(seed), time_s, "base_x", "base_tilt") for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.02


def _kinds(*kinds):
    # Of 2e-5 kg m^2 on a stiff laminate, a second mass moves less than 0.5 % of the angle; a larger one than the bench
    # has leaves its motor a negative inertia.
    two_mass = {"elastic-transmission", "gear-play"}
    usable = (effect for effect in effects() if effect.kind in kinds and "load" not in effect.needs)
    return sorted({effect.id for effect in usable} - two_mass)


@pytest.mark.parametrize(
    ("effect", "site"),
    [(effect, "axis_1") for effect in _kinds("joint")]
    + [(effect, "servo_2") for effect in _kinds("input")]
    + [(effect, "theta_2") for effect in _kinds("output")],
)
def test_a_hidden_effect_shows_and_does_not_swamp_the_bench(effect, site):
    def swing(hide):
        scene = _scene(noise=0, hide=hide)
        _seen(scene, np.array([0.0]), "theta_1")
        time_s = np.arange(0.0, 6.0, 0.01)
        angle = np.radians(20) * np.sin(2 * np.pi * 1.5 * time_s)
        for joint in scene.joints:
            scene.drive(joint, Trajectory((joint,), time_s, angle[:, None]), 0.0)
        return _seen(scene, np.arange(1.0, 5.0, 0.01), "theta_1", "theta_2")

    plain, hidden = swing([]), swing([{"effect": effect, "site": site}])
    share = np.abs(hidden - plain).max() / np.abs(plain).max()
    assert 0.005 < share < 1.5


def test_settings_that_do_not_hold_are_told_by_name():
    with pytest.raises(SpecError, match="base_tilt_deg"):
        _scene(base_tilt_deg=40)
    with pytest.raises(SpecError, match="no parameter 'mass'"):
        _scene(parameters={"mass": 0.1})


class _Stabiliser:
    """The loop of section 2 in its barest form: each servo goes on by gain times the tilt that is left."""

    def __init__(self, gain, seed=0, **keys):
        self.clock = HandClock(1.0)
        self.scene = _scene(seed, **keys)
        self.gain = gain
        joints = {"servo_1": {"id": 1}, "servo_2": {"id": 2}}
        self.servos = device(
            "simulated-dynamixel", "servos", {"port": "c", "joints": joints}, self.scene, self.clock
        )
        on_tip = {"port": "a", "mounted_on": "end_effector"}
        self.imu = device("simulated-bno055", "tip", on_tip, self.scene, self.clock, seed)
        self.servos.open()
        self.imu.open()
        self.imu.start()
        _seen(self.scene, np.array([self.clock.now()]), "base_tilt")
        self.angles = np.zeros(2)

    def run(self, duration_s):
        """Return the tilts (rad) of base and end-effector at each step."""
        tilts = []
        for _ in range(round(duration_s / STEP_S)):
            self.clock.sleep(STEP_S)
            samples = self.imu.read()
            if len(samples):
                roll, pitch = samples.values[-1, 5:7]
                self.angles = np.clip(self.angles + self.gain * np.array([roll, -pitch]), -0.7, 0.7)
            self.servos.follow(
                Trajectory(self.servos.joints, np.zeros(1), self.angles[None, :]), self.clock.now()
            )
            tilts.append(_seen(self.scene, np.array([self.clock.now()]), "base_tilt", "end_effector_tilt")[0])
        return np.array(tilts)


def test_a_proportional_loop_on_the_linear_model_keeps_the_end_effector_level():
    tilts = _Stabiliser(gain=0.2).run(20.0)[100:]
    base, tip = np.sqrt(np.mean(tilts**2, axis=0))
    assert tip < 0.3 * base


def _ultimate_gain(latency_s=0.0138):
    """Gain per step at which the loop's frequency response passes -1: servo, laminate, latency, hold, sum of steps."""
    omega = np.linspace(1.0, np.pi / STEP_S, 20_000)
    s = 1j * omega
    natural, (k, b, inertia, gravity) = 2 * np.pi * 15.0, (0.114, 6e-4, 2e-5, 6e-3)
    servo = natural**2 / (s**2 + 1.6 * natural * s + natural**2)
    laminate = k / (inertia * s**2 + b * s + k - gravity)
    late = np.exp(
        -s * (latency_s + 0.005 + 0.0025)
    )  # mean age of the newest sample, and of the servo's command
    hold = (1 - np.exp(-s * STEP_S)) / (s * STEP_S)
    loop = servo * laminate * late * hold / (1 - np.exp(-s * STEP_S))
    crossing = int(np.argmax(np.unwrap(np.angle(loop)) < -np.pi))
    return 1 / abs(loop[crossing])


def test_the_loop_becomes_unstable_at_the_gain_its_frequency_response_says():
    ultimate = _ultimate_gain()
    assert ultimate == pytest.approx(0.55, abs=0.02)
    calm, wild = (
        np.degrees(_Stabiliser(factor * ultimate, base_tilt_deg=1.0).run(12.0)[-200:, 1].max())
        for factor in (0.75, 1.3)
    )
    assert calm < 2.0
    assert wild > 20.0


def test_the_stabiliser_is_found_under_the_names_an_experiment_uses():
    assert registry.load("labrun.scenes", "spm-stabiliser") is SpmStabiliser
    assert registry.load("labrun.devices", "simulated-bno055").__name__ == "SimulatedBno055"
