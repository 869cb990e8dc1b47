"""A trial counts only if its devices are well at its end and its joints went where they were sent."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paddle_lab import Lab, experiment_with

from labrun.errors import DeviceError
from labrun.store import RunFolder

SHORT = {"trial__settle": None, "trial__tare": None, "trial__repeats": 1}
CONDITION = [{"a": 40, "f": 1.0}]
ENCODER = {**SHORT, "rig__devices__tail__plugin": "pond:EncoderServo"}


def test_a_device_that_restarts_during_the_last_trial_fails_it_and_the_run(lab):
    lab = lab(**SHORT, rig__devices__tail__restarts_after_s=1.5)
    with pytest.raises(DeviceError, match="device tail: reports a fault: it restarted, its torque is off"):
        lab.session.measure(CONDITION)
    (outcome,) = lab.folder.outcomes().values()
    assert outcome.status == "failed"
    assert "it restarted" in outcome.reason
    assert "safe_stop" in lab.stops()[-1]


def test_a_restart_during_a_resumed_run_fails_its_trial(lab, folder):
    first = lab(**SHORT, limit=1)
    with pytest.raises(Exception, match="new trials"):
        first.session.measure([*CONDITION, {"a": 20, "f": 1.0}])
    resumed = Lab(
        RunFolder.open(folder.path), experiment_with(**SHORT, rig__devices__tail__restarts_after_s=1.5)
    )
    with pytest.raises(DeviceError, match="it restarted"):
        resumed.session.measure([*CONDITION, {"a": 20, "f": 1.0}])
    assert [outcome.status for outcome in resumed.folder.outcomes().values()] == ["done", "failed"]


def test_a_jammed_joint_fails_the_trial_and_is_named_with_moment_and_distance(lab):
    lab = lab(**ENCODER, rig__devices__tail__jams_s=(1.0, 5.0))
    with pytest.raises(
        DeviceError, match=r"device tail: joint tail did not follow its command: from \d.* deg away"
    ):
        lab.session.measure(CONDITION)
    assert lab.folder.outcomes()[0].status == "failed"


def test_the_run_goes_on_after_a_jam_where_the_file_says_so(lab):
    lab = lab(**ENCODER, rig__devices__tail__jams_s=(1.0, 4.0), trial__on_fault="retry-trial")
    (measurement,) = lab.session.measure(CONDITION)
    assert [outcome.status for outcome in measurement.outcomes] == ["failed", "done"]


@pytest.mark.parametrize(
    "changes",
    [
        {"rig__devices__tail__jams_s": (2.0, 2.2)},
        {"rig__devices__tail__jams_s": (1.0, 5.0), "trial__follow__within_deg": 90.0},
        {"rig__devices__tail__lag_s": 0.1},
        {"rig__devices__tail__lag_s": 0.3, "trial__follow__lag_s": 0.3},
    ],
    ids=["a short jam", "a wide limit", "a usual lag", "a stated lag"],
)
def test_a_joint_within_what_the_file_allows_passes(lab, changes):
    lab = lab(**ENCODER, **changes)
    (measurement,) = lab.session.measure(CONDITION)
    assert measurement.outcomes[0].status == "done"


@settings(max_examples=15)
@given(lag_s=st.floats(0.0, 0.1), a=st.integers(0, 60), f=st.sampled_from([0.5, 1.0, 1.5]))
def test_a_joint_that_is_no_later_than_stated_always_passes(tmp_path_factory, lag_s, a, f):
    folder = RunFolder.create(tmp_path_factory.mktemp("lag"), "paddle", "title = 'x'", {"dry_run": True})
    changed = experiment_with(**ENCODER, rig__devices__tail__lag_s=lag_s, trial__cycles=2)
    (measurement,) = Lab(folder, changed).session.measure([{"a": a, "f": f}])
    assert measurement.outcomes[0].status == "done"
