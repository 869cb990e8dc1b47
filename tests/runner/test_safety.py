"""On any exit actuators stop first; only then is data saved."""

import os
import signal

import pytest

from labrun.errors import ExperimentError, StoreError
from labrun.interrupts import Interrupted
from labrun.runner.safety import stop_all
from labrun.store import RunFolder, TrialWriter

ONE = [{"a": 10, "f": 1.0}]


@pytest.fixture
def witnessed(lab, tmp_path, monkeypatch):
    """Return a lab maker whose stop log also notes every store."""
    log = tmp_path / "stops.log"
    finish = TrialWriter.finish

    def noted(self, outcome, settle_curve, command):
        with log.open("a") as file:
            file.write("store\n")
        finish(self, outcome, settle_curve, command)

    monkeypatch.setattr(TrialWriter, "finish", noted)
    return lab


def during(lab, time_s, action):
    """Do something at a time on the lab's clock."""
    sleep = lab.clock.sleep
    done = []

    def sleeping(duration_s):
        sleep(duration_s)
        if lab.clock.now() >= time_s and not done:
            done.append(True)
            action()

    lab.clock.sleep = sleeping


def test_a_regular_trial_comes_to_its_safe_pose_before_it_is_stored(witnessed):
    lab = witnessed(trial__repeats=1)
    lab.session.measure(ONE)
    assert lab.stops() == ["follow tail", "follow tail", "store"]
    assert lab.rig.actuators["tail"].pose()["tail"] == pytest.approx(0.0872664)
    events = [event["event"] for event in lab.folder.journal.events()]
    assert events == ["created", "prepare", "record", "safe-pose", "trial"]


@pytest.mark.parametrize(
    "changes",
    [
        {"rig__devices__cell__silent_after_s": 5.0},
        {"rig__devices__cell__nan_after_s": 5.0},
        {"rig__devices__cell__limits": {"force_n": 0.3}},
        {"rig__devices__tail__runaway_after_s": 5.0},
    ],
    ids=["lost device", "nonsense", "limit", "runaway"],
)
def test_a_fault_stops_actuators_before_data_is_saved(witnessed, changes):
    lab = witnessed(**changes)
    with pytest.raises(ExperimentError):
        lab.session.measure(ONE)
    lines = [line.split()[0] for line in lab.stops()]
    assert "store" in lines
    assert lines.index("safe_stop") < lines.index("store")
    assert lines[lines.index("safe_stop") :].count("follow") == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_stops_actuators_first_keeps_data_and_resumes_to_the_same_result(
    witnessed, number, tmp_path
):
    lab = witnessed()
    during(lab, 9.0, lambda: os.kill(os.getpid(), number))
    with pytest.raises(Interrupted, match="actuators are stopped, data is kept"):
        lab.session.measure(ONE)
    lines = [line.split()[0] for line in lab.stops()]
    assert lines[-2:] != ["store", "safe_stop"]
    assert "safe_stop" in lines
    assert lines[lines.index("safe_stop") :].count("follow") == 0
    kept = lab.folder.outcomes()
    assert kept[0].status == "done"
    again = witnessed(folder=RunFolder.open(lab.folder.path)).session.measure(ONE)
    whole = witnessed(folder=RunFolder.create(tmp_path / "other", "paddle", "t = 1", {})).session.measure(ONE)
    assert again == whole


def test_pressing_ctrl_c_again_stops_again_and_breaks_nothing(witnessed):
    lab = witnessed()

    def twice():
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    during(lab, 9.0, twice)
    with pytest.raises(Interrupted):
        lab.session.measure(ONE)
    assert RunFolder.open(lab.folder.path).faults == []


def test_an_exception_from_anywhere_stops_actuators_first(witnessed):
    lab = witnessed()

    def fail():
        raise ZeroDivisionError

    during(lab, 5.0, fail)
    with pytest.raises(ZeroDivisionError):
        lab.session.measure(ONE)
    lines = [line.split()[0] for line in lab.stops()]
    assert lines.index("safe_stop") < lines.index("store")


def test_a_device_that_cannot_be_stopped_is_reported_and_keeps_nobody_else_from_stopping(lab):
    lab = lab(rig__devices__tail__stop_fails=True)
    failures = lab.rig.safe_stop()
    assert failures == ["tail could not be stopped: OSError: the cable is gone"]


def test_a_device_whose_stop_hangs_does_not_keep_the_others_moving():
    import threading

    class Hanging:
        def safe_stop(self):
            threading.Event().wait(10)

    class Prompt:
        stopped = False

        def safe_stop(self):
            self.stopped = True

    prompt = Prompt()
    failures = stop_all({"hanging": Hanging(), "prompt": prompt})
    assert prompt.stopped
    assert failures == ["hanging did not stop within 2 s"]


def test_stopping_twice_is_harmless(lab):
    rig = lab().rig
    assert rig.safe_stop() == rig.safe_stop() == []


def test_a_failing_store_leaves_actuators_in_their_safe_pose(lab, monkeypatch):
    def no_room(self, outcome, settle_curve, command):
        raise StoreError("no space left on device")

    monkeypatch.setattr(TrialWriter, "finish", no_room)
    lab = lab()
    with pytest.raises(StoreError):
        lab.session.measure(ONE)
    assert lab.rig.actuators["tail"].pose()["tail"] == pytest.approx(0.0872664)
