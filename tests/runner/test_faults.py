"""Bad days of devices: each becomes a clear error, and costs at most its own trial."""

import pytest

from labrun.errors import DeviceError, RequestError, SettleError, SpecError
from labrun.runner import resolve_device
from labrun.runner.safety import NonsenseError, SilentDeviceError
from labrun.toml import PluginTable

ONE = [{"a": 10, "f": 1.0}]
TWO = [{"a": 10, "f": 1.0}, {"a": 20, "f": 1.0}]


def test_a_sensor_that_stops_answering_ends_the_run_by_name_with_its_data_kept(lab):
    lab = lab(rig__devices__cell__silent_after_s=20.0)
    with pytest.raises(
        SilentDeviceError, match=r"device cell: stopped answering: no sample for .* at 100 samples/s"
    ):
        lab.session.measure(TWO)
    stored = list(lab.folder.outcomes().values())
    assert stored[-1].status == "failed"
    assert "device cell: stopped answering" in stored[-1].reason
    assert [outcome.status for outcome in stored[:-1]] == ["done"] * (len(stored) - 1)


def test_nonsense_is_an_error_that_names_channel_and_value(lab):
    lab = lab(rig__devices__cell__nan_after_s=20.0)
    with pytest.raises(NonsenseError, match="device cell: sent an implausible value: force_x = nan N"):
        lab.session.measure(TWO)


def test_a_block_of_a_wrong_shape_is_an_error_that_says_so(lab):
    with pytest.raises(NonsenseError, match="fault of its driver"):
        lab(rig__devices__cell__bad_shape=True).session.measure(ONE)


def test_a_saturated_recording_is_rejected_with_its_reason_and_replaced(lab):
    (result,) = lab(rig__devices__cell__saturated_trials=[0]).session.measure(ONE)
    assert [outcome.status for outcome in result.outcomes] == ["rejected", "done", "done"]
    assert "samples at the end of the measuring range" in result.outcomes[0].reason
    assert "thrust" in result.outcomes[0].objectives


def test_a_recording_that_lost_too_many_samples_is_rejected_and_replaced(lab):
    (result,) = lab(rig__devices__cell__lossy_trials=[1]).session.measure(ONE)
    assert [outcome.status for outcome in result.outcomes] == ["done", "rejected", "done"]
    assert "samples were lost (50 %, 2 % is allowed)" in result.outcomes[1].reason


def test_a_condition_that_is_always_rejected_does_not_hold_the_run_for_ever(lab):
    (result,) = lab(rig__devices__cell__saturated_trials=list(range(99))).session.measure(ONE)
    assert len(result.outcomes) == 3
    assert not result.accepted


def test_a_faulty_trial_is_tried_again_on_a_reopened_device_where_the_file_says_so(lab):
    lab = lab(
        trial__on_fault="retry-trial",
        rig__devices__cell__silent_trials=[1],
        rig__devices__cell__silent_times=1,
    )
    (result,) = lab.session.measure(ONE)
    assert [(o.status, o.attempt, o.repeat) for o in result.outcomes] == [
        ("done", 0, 0), ("failed", 0, 1), ("done", 1, 1),
    ]  # fmt: skip
    assert lab.rig.devices["cell"].opened == 2


def test_a_faulty_trial_is_left_out_where_the_file_says_so(lab):
    lab = lab(trial__on_fault="skip", rig__devices__cell__silent_trials=[0])
    result = lab.session.measure(TWO)
    outcomes = lab.session.outcomes
    assert outcomes[0].status == "failed"
    assert all(outcome.attempt == 0 for outcome in outcomes)
    assert [len(m.accepted) for m in result] == [2, 2]


def test_a_plan_is_not_worn_out_by_a_device_that_fails_in_every_trial(lab):
    lab = lab(
        trial__on_fault="skip",
        trial__repeats={"min": 20, "max": 30},
        rig__devices__cell__silent_trials=list(range(100)),
        rig__devices__cell__silent_times=100,
    )
    with pytest.raises(
        DeviceError, match="device cell: 10 trials failed one after the other; the last: device cell"
    ):
        lab.session.measure(ONE)
    assert [outcome.status for outcome in lab.session.outcomes] == ["failed"] * 10


def test_a_stopped_run_goes_on_after_the_fault_with_the_faulty_trial_kept(lab):
    from labrun.store import RunFolder

    broken = lab(rig__devices__cell__silent_trials=[1])
    with pytest.raises(SilentDeviceError):
        broken.session.measure(TWO)
    mended = lab(folder=RunFolder.open(broken.folder.path))
    result = mended.session.measure(TWO)
    assert [len(m.accepted) for m in result] == [2, 2]
    assert mended.folder.outcomes()[1].status == "failed"


def test_a_bench_that_never_settles_stops_the_run_where_the_file_says_so(lab):
    lab = lab(
        rig__scene={"plugin": "pond:Pond", "echo_n": 50.0, "decay_s": 1e6},
        trial__settle__timeout_s=8,
        trial__settle__on_timeout="stop",
    )
    with pytest.raises(SettleError, match=r"not at rest after 8 s: cell.force_x spreads by"):
        lab.session.measure(ONE)
    assert lab.stops()[-1].startswith("safe_stop tail")


def test_devices_that_do_not_open_are_all_reported_and_the_others_closed(lab):
    with pytest.raises(DeviceError, match="device cell: does not answer"):
        lab(rig__devices__cell__open_fails=True)
    with pytest.raises(DeviceError) as caught:
        lab(
            rig__devices__cell__open_fails=True,
            rig__devices__other={"plugin": "pond:Cell", "open_fails": True},
        )
    assert "cell" in str(caught.value)
    assert "other" in str(caught.value)


def test_a_carriage_that_does_not_arrive_is_an_error_with_its_position(lab):
    lab = lab(
        rig__devices__sledge={"plugin": "pond:Sledge", "obstacle_m": 0.2},
        trial__carriage={"device": "sledge", "speed_m_s": 0.1, "from_m": 0.0, "to_m": 0.9},
    )
    with pytest.raises(
        DeviceError, match=r"device sledge: did not arrive: it stands at 0.2 m, 0 m was commanded"
    ):
        lab.session.measure(ONE)


def test_a_full_disk_ends_the_run_with_actuators_stopped_before(lab, monkeypatch):
    from labrun.errors import StoreError
    from labrun.store import TrialWriter

    lab = lab()

    def no_room(self, outcome, settle_curve, command):
        raise StoreError("no space left on device: trial not saved")

    monkeypatch.setattr(TrialWriter, "finish", no_room)
    with pytest.raises(StoreError):
        lab.session.measure(ONE)
    assert lab.folder.outcomes() == {}


def test_a_missing_port_is_named_with_its_device_and_the_way_round(tmp_path):
    from paddle_lab import experiment_with

    from labrun.runner import RealClock, Rig

    experiment = experiment_with(rig__devices__tail__port="/dev/ttyNOTHERE7")
    with pytest.raises(RequestError) as caught:
        Rig.build(experiment, clock=RealClock(), seed=1, dry_run=False)
    text = str(caught.value)
    assert "device tail: port /dev/ttyNOTHERE7 does not exist" in text
    assert "--dry-run works without it" in text


def test_a_driver_that_is_not_installed_is_named_with_its_port_and_the_way_round():
    from paddle_lab import experiment_with

    from labrun.runner import RealClock, Rig

    experiment = experiment_with(
        rig__devices__tail={"plugin": "servo", "port": "/dev/ttyACM0"},
    )
    with pytest.raises(
        RequestError, match="device tail at /dev/ttyACM0: driver 'servo' is not installed"
    ) as caught:
        Rig.build(experiment, clock=RealClock(), seed=1, dry_run=False)
    assert "--dry-run works without it" in str(caught.value)


def test_an_unknown_key_of_a_device_is_an_error_with_the_keys_it_knows(lab):
    with pytest.raises(RequestError, match=r"rig\.devices\.cell.noize_n") as caught:
        lab(rig__devices__cell__noize_n=1.0)
    assert "noise_n" in str(caught.value)


def test_whatever_a_driver_raises_names_its_device(lab):
    lab = lab(rig__devices__tail__pose_fails_after_s=6.0)
    with pytest.raises(
        DeviceError, match=r"device tail: its driver failed in \w+\(\): OSError: the cable is gone"
    ):
        lab.session.measure(ONE)
    assert lab.folder.outcomes()[0].status == "failed"


def test_faults_that_a_driver_is_to_play_are_told_to_be_for_a_dry_run():
    table = PluginTable.model_validate(
        {"plugin": "robotiq-ft300", "port": "/dev/ttyUSB0", "faults": {"drop_share": 0.1}}
    )
    resolve_device("wrench", table, dry_run=True)
    with pytest.raises(SpecError, match=r"rig\.devices\.wrench\.faults: only a dry run plays faults"):
        resolve_device("wrench", table, dry_run=False)
