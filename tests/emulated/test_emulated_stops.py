"""Whatever ends a run, the actuators stop first: the emulator's own log is the witness.

How quickly they stop is measured by ``benchmarks/safe_stop.py``; here only that they do, and in which order.
"""

import os
import signal

import pytest
from emulated_lab import CLOCK, emulated_lab

from labrun.errors import DeviceError, LimitExceededError
from labrun.runner import Interrupted

LONG = {"trial__cycles": 30}
SOON_S = 1.0


def stopped_after(lab, moment_s):
    """Return the emulator's first stop after a moment, and the last command that moved."""
    stops = [line["time_s"] for line in lab.events("tail", "stop") if line["time_s"] >= moment_s]
    assert stops, "the emulator saw no stop"
    return stops[0]


def test_ctrl_c_stops_the_servo_before_anything_is_stored_and_keeps_what_was_recorded(tmp_path):
    pressed = []

    def press():
        pressed.append(CLOCK.now())
        os.kill(os.getpid(), signal.SIGINT)

    with emulated_lab(tmp_path, **LONG) as lab:
        lab.watcher.when_recording(SOON_S, press)
        with pytest.raises(Interrupted, match="Ctrl-C"):
            lab.measure()
        stop_s = stopped_after(lab, pressed[0])
        (journalled,) = lab.journal("stopped")
        assert stop_s < journalled["clock_s"]
        assert [line for line in lab.events("tail", "command") if line["time_s"] > stop_s + 0.005] == []
        outcome = lab.folder.outcomes()[0]
        assert outcome.status == "failed"
        assert "Ctrl-C" in outcome.reason
        assert outcome.checkpoint is None


@pytest.mark.parametrize("fault", ["silence", "unplug"])
def test_a_lost_sensor_stops_the_servo_and_is_named(tmp_path, fault):
    with emulated_lab(tmp_path, **LONG) as lab:
        lost = []
        lab.watcher.when_recording(
            SOON_S, lambda: (lost.append(CLOCK.now()), lab.bench.inject("wrench", fault))
        )
        with pytest.raises(DeviceError, match="device wrench: ") as caught:
            lab.measure()
        assert caught.value.hint
        stop_s = stopped_after(lab, lost[0])
        assert stop_s < lab.journal("stopped")[0]["clock_s"]
        assert lab.folder.outcomes()[0].status == "failed"


def test_a_force_beyond_its_limit_stops_the_servo(tmp_path):
    # the sensor wakes up with an offset of some newtons, so the first sample taken under watch is beyond the limit
    with emulated_lab(tmp_path, rig__devices__wrench__limits={"force_n": 0.05}) as lab:
        begun_s = CLOCK.now()
        with pytest.raises(LimitExceededError, match=r"device wrench: force_\w"):
            lab.measure()
        assert stopped_after(lab, begun_s) < lab.journal("stopped")[0]["clock_s"]


def test_an_exception_in_the_midst_of_a_recording_stops_the_servo(tmp_path, monkeypatch):
    with emulated_lab(tmp_path, **LONG) as lab:
        sensor = lab.rig.sensors["wrench"]
        read, failing = sensor.read, []

        def fail():
            if failing:
                raise ZeroDivisionError("a driver with a bug")
            return read()

        monkeypatch.setattr(sensor, "read", fail)
        lab.watcher.when_recording(SOON_S, lambda: failing.append(CLOCK.now()))
        with pytest.raises(DeviceError, match="device wrench: its driver failed: ZeroDivisionError"):
            lab.measure()
        assert stopped_after(lab, failing[0]) < lab.journal("stopped")[0]["clock_s"]


def test_a_servo_that_does_not_hear_the_stop_is_stopped_by_its_own_watchdog(tmp_path):
    with emulated_lab(tmp_path, **LONG) as lab:
        lab.watcher.when_recording(SOON_S, lambda: lab.bench.inject("tail", "unplug"))
        with pytest.raises(DeviceError, match="device tail: ") as caught:
            lab.measure()
        assert caught.value.hint
        expired = lab.events("tail", "watchdog")
        assert expired, "the board's watchdog did not expire"
        last = max(line["time_s"] for line in lab.events("tail", "fault"))
        assert expired[0]["time_s"] > last


def test_after_a_fault_the_trial_is_done_again_if_the_file_says_so(tmp_path):
    changes = {"trial__on_fault": "retry-trial", "trial__retries": 1, "trial__cycles": 4}
    with emulated_lab(tmp_path, **changes) as lab:

        def blink():
            lab.bench.inject("wrench", "unplug")
            CLOCK.sleep(0.3)
            lab.bench.clear("wrench", "unplug")

        lab.watcher.when_recording(SOON_S, blink)
        failed, done = lab.measure()
        assert (failed.status, done.status) == ("failed", "done")
        assert "device wrench" in failed.reason
        assert any("device wrench" in note for note in lab.watcher.notes)
        assert done.objectives["push"] > 0


def test_a_fault_costs_its_trial_alone_if_the_file_says_skip(tmp_path):
    conditions = [{"a": 20}, {"a": 10}]
    changes = {"trial__on_fault": "skip", "run__conditions": conditions, "trial__cycles": 4}
    with emulated_lab(tmp_path, **changes) as lab:

        def blink():
            lab.bench.inject("wrench", "unplug")
            CLOCK.sleep(0.3)
            lab.bench.clear("wrench", "unplug")

        lab.watcher.when_recording(SOON_S, blink)
        measured = lab.session.measure(conditions, order="as-listed")
        assert [item.outcomes[0].status for item in measured] == ["failed", "done"]


def test_saturation_rejects_a_trial_and_an_error_status_fails_one_and_both_are_measured_again(tmp_path):
    box = {"plugin": "ati-netft", "host": "192.168.1.1", "rate_hz": 1000}
    conditions = [{"a": 20}, {"a": 10}]
    changes = {"trial__on_fault": "skip", "run__conditions": conditions, "trial__cycles": 2}
    with emulated_lab(tmp_path, rig__devices__wrench=box, **changes) as lab:

        def blink(fault):
            lab.bench.inject("wrench", fault)
            CLOCK.sleep(0.1)
            lab.bench.clear("wrench", fault)

        def first():
            lab.watcher.when_recording(SOON_S, lambda: blink("error"))
            blink("saturate")

        lab.watcher.when_recording(SOON_S, first)
        saturated, broken = lab.session.measure(conditions, order="as-listed")
        assert [outcome.status for outcome in saturated.outcomes] == ["rejected", "done"]
        assert "device wrench: " in saturated.outcomes[0].reason
        assert "end of the measuring range" in saturated.outcomes[0].reason
        assert [outcome.status for outcome in broken.outcomes] == ["failed", "done"]
        assert "device wrench: reports an error: analogue board error" in broken.outcomes[0].reason
        recorded = lab.folder.outcomes()
        assert [recorded[index].status for index in sorted(recorded)] == [
            "rejected",
            "failed",
            "done",
            "done",
        ]


def test_a_servo_that_lost_its_power_for_a_moment_fails_the_trial_it_happened_in(tmp_path):
    tail = {
        "plugin": "dynamixel",
        "port": "/dev/ttyUSB9",
        "joints": {"tail": {"id": 1}},
        "limits": {"angle_deg": [-60, 60], "speed_deg_s": 528},
    }
    with emulated_lab(tmp_path, rig__devices__tail=tail, trial__cycles=2) as lab:
        lab.watcher.when_recording(SOON_S, lambda: lab.bench.inject("tail", "restart", 1))
        with pytest.raises(DeviceError, match="device tail: "):
            lab.measure()
        outcome = lab.folder.outcomes()[0]
        assert outcome.status == "failed"
        assert "tail" in outcome.reason
