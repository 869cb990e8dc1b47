"""What is watched while a trial goes on, and not only before it."""

import pytest

from labrun.errors import DeviceError, LimitExceededError
from labrun.runner import SilentProgress
from labrun.store.folder import RunFolder

LONG = {"trial__cycles": 500, "trial__repeats": 1}
ONE = [{"a": 10, "f": 1.0}]


def test_a_servo_that_overheats_in_a_long_trial_is_stopped_within_seconds(lab):
    lab = lab(
        **LONG,
        rig__devices__tail__hot_after_s=60.0,
        rig__devices__tail__limits={"angle_deg": [-60, 60], "temperature_c": 65.0},
    )
    with pytest.raises(LimitExceededError, match="temperature 90 degC is above the limit of 65 degC"):
        lab.session.measure(ONE)
    assert lab.clock.now() < 70.0
    assert lab.stops()[-1].startswith("safe_stop")


def test_a_temperature_that_is_not_a_number_is_not_taken_for_cool(lab):
    lab = lab(
        rig__devices__tail__temperature_c=float("nan"),
        rig__devices__tail__limits={"temperature_c": 65.0},
    )
    with pytest.raises(LimitExceededError, match="temperature is not a number"):
        lab.session.measure(ONE)


@pytest.mark.parametrize("angle", [None, [-60, 60]])
def test_a_joint_that_moves_faster_than_its_limit_is_stopped_by_its_measured_speed(lab, angle):
    limits = {"speed_deg_s": 100.0} if angle is None else {"speed_deg_s": 100.0, "angle_deg": angle}
    lab = lab(**LONG, rig__devices__tail__dash_after_s=6.0, rig__devices__tail__limits=limits)
    lab.clock.poll_s = 0.25
    with pytest.raises(LimitExceededError, match=r"device tail: measured speed of tail .* deg/s is"):
        lab.session.measure(ONE)
    assert lab.stops()[-1].startswith("safe_stop")


def test_a_joint_within_its_speed_is_let_be(lab):
    lab = lab(trial__repeats=1, rig__devices__tail__limits={"speed_deg_s": 70.0})
    lab.clock.poll_s = 0.02
    (result,) = lab.session.measure(ONE)
    assert result.accepted


def test_a_driver_that_cannot_say_what_it_is_is_named(lab):
    with pytest.raises(DeviceError, match=r"device tail: its driver failed in \w+\(\): OSError: no answer"):
        lab(rig__devices__tail__identify_fails=True).rig.identities()


def test_a_device_that_does_not_come_back_after_a_fault_is_named(lab):
    lab = lab(
        trial__on_fault="skip",
        rig__devices__tail__pose_fails_after_s=6.0,
        rig__devices__tail__reopen_fails=True,
    )
    with pytest.raises(
        DeviceError, match=r"device tail: its driver failed in \w+\(\): OSError: the port is gone"
    ):
        lab.session.measure(ONE)
    assert RunFolder.open(lab.folder.path).outcomes()[0].status == "failed"


class Notes(SilentProgress):
    """Keeps what a person would have read."""

    def __init__(self):
        self.notes = []

    def note(self, text):
        self.notes.append(text)


def test_a_bench_that_never_rests_is_warned_of_once_and_journalled_every_time(lab):
    notes = Notes()
    lab = lab(
        progress=notes,
        rig__scene={"plugin": "pond:Pond", "echo_n": 50.0, "decay_s": 1e6},
        trial__settle__timeout_s=8,
        trial__repeats=3,
    )
    lab.session.measure(ONE)
    events = [event for event in lab.folder.journal.events() if event["event"] == "settle-timeout"]
    assert [event["index"] for event in events] == [1, 2]
    (note,) = notes.notes
    assert "trial 1 was recorded although the bench had not come to rest in 8 s" in note
