"""A slider of two states: the driver against its emulator in another process, and the stand-in on a bench."""

import numpy as np
import pytest
from emulated import emulated
from labrun_plugins.rigs.buckling_fin.gait_rig import GaitRig
from labrun_plugins.simulated.tendon_slider import SimulatedTendonSlider, SimulatedTendonSliderSettings
from labrun_plugins.tendon_slider.settings import TendonSliderSettings

from labrun.devices import Actuator, DeviceContext
from labrun.devices.protocols import Arranging
from labrun.errors import DeviceError
from labrun.runner import SimulatedClock

KEYS = {"port": "/dev/ttyACM1", "move_s": 0.2, "arrive_s": 0.3, "watchdog_ms": 500}


@pytest.fixture(scope="module")
def shared():
    with emulated("tendon-slider", KEYS, name="slider") as bench:
        yield bench


@pytest.fixture
def bench(shared):
    shared.driver.open()
    yield shared
    shared.driver.safe_stop()
    shared.driver.close()


def test_it_arranges_and_moves_no_joint(bench):
    assert isinstance(bench.driver, Arranging)
    assert not isinstance(bench.driver, Actuator)
    assert bench.driver.identify().firmware == "labslider 1.0"
    assert {remark.verdict for remark in bench.driver.examine()} == {"ok"}


def test_it_goes_into_the_state_that_a_condition_names_and_its_switches_verify_it(bench):
    for state, position_m in (("short", 1.0), ("long", 0.0)):
        bench.driver.arrange({"beam": state, "f": 0.3})
        assert not bench.driver.arrived()
        bench.wait_until(bench.driver.arrived)
        assert bench.events("slider")[-1]["position"] == pytest.approx(position_m, abs=1e-3)
        assert bench.driver.health().ok


def test_without_the_condition_it_takes_the_state_of_the_file(bench):
    bench.driver.arrange({"f": 0.3})
    bench.wait_until(bench.driver.arrived)
    assert bench.events("slider")[-1]["position"] == pytest.approx(0.0, abs=1e-3)


def test_a_slider_that_does_not_arrive_is_stopped_and_said_and_goes_on_once_it_is_free(bench):
    bench.driver.arrange({"beam": "long"})
    bench.wait_until(bench.driver.arrived)
    bench.inject("stuck", 0.6)
    asked_s = bench.clock.now()
    bench.driver.arrange({"beam": "short"})
    with pytest.raises(DeviceError) as missed:
        bench.wait_until(bench.driver.arrived)
    assert "'short' was requested, and none of its switches is closed" in str(missed.value)
    assert "labrun resume" in str(missed.value.hint)
    assert bench.wait_for("stop", after_s=asked_s)
    bench.clear("stuck")
    bench.driver.arrange({"beam": "short"})
    bench.wait_until(bench.driver.arrived)


@pytest.mark.slow
def test_a_slider_that_is_stuck_on_the_bench_does_not_arrive_either():
    stuck = {"scene": "gait-rig", "scene_settings": {"slider_stuck_at": 0.4}}
    with emulated("tendon-slider", KEYS, name="slider", **stuck) as bench:
        bench.driver.open()
        bench.driver.arrange({"beam": "short"})
        with pytest.raises(DeviceError, match="did not arrive"):
            bench.wait_until(bench.driver.arrived)
        bench.driver.close()


def test_a_slider_that_leaves_its_state_makes_the_device_unwell(bench):
    bench.driver.arrange({"beam": "short"})
    bench.wait_until(bench.driver.arrived)
    bench.inject("stuck", 0.5)
    health = bench.driver.health()
    bench.clear("stuck")
    assert not health.ok
    assert "has left 'short'" in health.notes[-1]


def test_a_state_that_it_does_not_have_is_refused_before_anything_moves(bench):
    before = len(bench.events("command"))
    with pytest.raises(DeviceError, match="not one of its states") as refused:
        bench.driver.arrange({"beam": "medium"})
    assert "'long' and 'short'" in str(refused.value.hint)
    assert len(bench.events("command")) == before


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"states": ["a", "a"]}, "both"),
        ({"state": "shrt"}, "not one of states"),
        ({"pulled_us": 1005}, "10 us"),
    ],
)
def test_settings_that_contradict_themselves_are_refused(keys, message):
    with pytest.raises(ValueError, match=message):
        TendonSliderSettings.model_validate({**KEYS, **keys})


def stand_in(**scene):
    clock = SimulatedClock()
    rig = GaitRig({"noise": 0, **scene}, np.random.default_rng(0))
    settings = SimulatedTendonSliderSettings.model_validate(KEYS)
    made = SimulatedTendonSlider("slider", settings, DeviceContext(clock, np.random.default_rng(0), rig))
    made.open()
    return made, clock, rig


def wait(made, clock):
    for _ in range(100):
        if made.arrived():
            return
        clock.sleep(0.02)
    raise AssertionError("neither arrived nor said why not")


def test_the_stand_in_changes_the_beams_of_its_bench():
    made, clock, rig = stand_in()
    for state in ("short", "long", "short"):
        made.arrange({"beam": state})
        wait(made, clock)
        assert rig.truth()["beam"] == state


def test_the_stand_in_says_when_the_benchs_slider_is_stuck():
    made, clock, rig = stand_in(slider_stuck_at=0.4)
    made.arrange({"beam": "long"})
    wait(made, clock)
    made.arrange({"beam": "short"})
    with pytest.raises(DeviceError, match="did not arrive"):
        wait(made, clock)
    assert rig.truth()["beam"] == "long"
