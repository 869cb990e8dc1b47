"""The driver in front of an emulated Motive: connection, layouts, what it hands over and what it says of itself."""

import socket

import numpy as np
import pytest
from emulated import emulated
from labrun_plugins.optitrack.driver import OptiTrack
from labrun_plugins.optitrack.session import local_address, open_command, open_multicast
from labrun_plugins.optitrack.settings import OptiTrackSettings
from optitrack_bench import BENCH, KEYS, at_least, collect, is_one_row_of_frames

from labrun.devices import DeviceContext, Sensor, Tracker
from labrun.errors import DeviceError
from labrun.runner import RealClock

SERVERS = [
    {"natnet": "3.0", "extra-nul": True},
    {"natnet": "4.0", "unstamped": True},
    {"natnet": "4.1", "multicast": True},
]


@pytest.fixture(scope="module")
def served():
    with emulated("optitrack", KEYS, **BENCH) as bench:
        yield bench


def _open(bench):
    bench.driver.open()
    bench.driver.start()


@pytest.mark.parametrize("server", SERVERS, ids=lambda server: " ".join(map(str, server.values())))
def test_bodies_markers_and_angles_come_from_every_kind_of_server(server):
    with emulated("optitrack", KEYS, **BENCH, faults=server) as bench:
        _open(bench)
        assert isinstance(bench.driver, Sensor)
        assert isinstance(bench.driver, Tracker)
        samples = collect(bench, at_least(80))
        names = [channel.name for channel in bench.driver.channels]
        truth = bench.bench.scene.observe(tuple(names[:7]), np.array([bench.clock.now()]))[0]
    assert is_one_row_of_frames(samples)
    assert samples.lost == 0
    # The body hangs still; the stand-in's noise is 0.1 mm and 1.5 mrad.
    mean, spread = samples.values.mean(axis=0), samples.values.std(axis=0)
    assert mean[:3] == pytest.approx(truth[:3], abs=1e-4)
    assert mean[3:7] == pytest.approx(truth[3:7], abs=1e-3)
    assert spread[:3] == pytest.approx(1e-4, rel=0.4)
    assert spread[names.index("angle")] == pytest.approx(1.5e-3, rel=0.4)
    assert names[8:] == [f"arm_marker{n}_{axis}" for n in (1, 2) for axis in "xyz"]
    first, second = mean[8:11] - mean[:3], mean[11:14] - mean[:3]
    assert np.hypot.reduce(first) == pytest.approx(0.035, abs=1e-3)
    assert np.hypot.reduce(second) == pytest.approx(0.035, abs=1e-3)
    assert not np.allclose(first, second, atol=0.01)


def test_device_time_is_that_of_exposure_and_apart_from_the_time_of_receipt(served):
    _open(served)
    samples = collect(served, at_least(60))
    served.wait_until(lambda: "clock_offset_s" in served.driver.identify().details)
    details = served.driver.identify().details
    served.driver.close()
    delay_s = samples.host_time_s + float(details["clock_offset_s"]) - samples.device_time_s
    assert delay_s.min() >= 0.0055 - float(details["echo_round_trip_s"]) - 1e-4  # Motive needs 5.5 ms
    assert np.median(delay_s) < 0.1


def test_it_says_who_answered_and_how_and_pins_the_layout_it_was_asked_for():
    with emulated(
        "optitrack", {**KEYS, "up_axis": "z", "bitstream": "4.0"}, **BENCH, faults={"natnet": "4.2"}
    ) as bench:
        _open(bench)
        identity = bench.driver.identify()
        assert (identity.model, identity.firmware) == ("OptiTrack, Motive", "Motive 3.1.0.0")
        details = dict(identity.details)
        assert details["natnet"] == "4.2.0.0"
        assert details["bitstream"] == "4.0"
        assert any(line["command"] == "Bitstream,4.0" for line in bench.events("request"))
        assert is_one_row_of_frames(collect(bench, at_least(20)))
        assert details["rate_hz"] == "240"
        assert details["up_axis"] == "z"
        assert details["bodies"] == "arm = 11"
        assert details["clock_hz"] == "10000000"
        assert details["interface"] == "127.0.0.1"
        assert bench.driver.health().ok
        remarks = bench.driver.examine()
        assert {remark.verdict for remark in remarks} <= {"ok", "warning"}
        assert any("z points up" in remark.message for remark in remarks)
        bench.driver.close()
        bench.wait_for("disconnect")
        assert not bench.driver.health().ok


def test_signs_of_life_keep_the_server_sending(served):
    served.inject("forget", 1.9)
    began_s = served.clock.now()
    _open(served)
    collect(served, at_least(int(2.3 * 240)), within_s=20.0)
    served.driver.close()
    served.clear("forget")
    assert len([line for line in served.events("keep-alive") if line["time_s"] > began_s]) >= 2
    assert not [line for line in served.events("forgotten") if line["time_s"] > began_s]


@pytest.mark.parametrize(
    ("fault", "value", "message", "hint"),
    [
        ("rate", 120, "120 frames/s", "rate_hz"),
        ("missing-body", "arm", "no rigid body arm", "wand"),
        ("no-frames", True, "no unicast frame", "live"),
        ("layout", "3.0", "do not fit NatNet 4.1", "bitstream"),
    ],
)
def test_what_does_not_fit_the_file_is_told_at_the_beginning(served, fault, value, message, hint):
    served.inject(fault, value)
    with pytest.raises(DeviceError, match=message) as caught:
        served.driver.open()
    assert hint in str(caught.value.hint)
    assert caught.value.device == "cameras"
    served.clear(fault)
    served.driver.open()
    assert served.driver.health().ok
    served.driver.close()


def test_a_file_that_insists_on_another_transmission_is_told():
    keys = {**KEYS, "transmission": "unicast"}
    with (
        emulated("optitrack", keys, **BENCH, faults={"multicast": True}) as bench,
        pytest.raises(DeviceError, match="streams multicast") as caught,
    ):
        bench.driver.open()
    assert "Transmission Type" in str(caught.value.hint)


def _alone(**keys):
    settings = OptiTrackSettings.model_validate({"host": "127.0.0.1", **keys})
    return OptiTrack("cameras", settings, DeviceContext(RealClock(), np.random.default_rng(0)))


def test_no_server_is_told_with_what_to_do():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with pytest.raises(DeviceError, match=f"no answer from Motive at 127.0.0.1:{port}") as caught:
        _alone(command_port=port).open()
    assert "ping 127.0.0.1" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"interface": "nowhere0"}, "interface 'nowhere0' is not one"),
        ({"interface": "192.0.2.77"}, "cannot listen on 192.0.2.77"),
        ({"host": "motive.invalid"}, "has no address"),
    ],
)
def test_an_interface_or_host_that_is_not_there_is_told(keys, message):
    with pytest.raises(DeviceError, match=message):
        _alone(**keys).open()


def test_what_is_not_open_or_not_streaming_says_so():
    driver = _alone()
    driver.safe_stop()
    driver.close()
    assert driver.health().notes == ("not connected",)
    for call in (driver.read, driver.start, driver.identify, driver.examine):
        with pytest.raises(DeviceError, match="not open"):
            call()


def test_sockets_are_bound_to_the_interface_or_the_group_and_never_to_all():
    assert local_address("cameras", "127.0.0.1", "") == "127.0.0.1"
    assert local_address("cameras", "127.0.0.1", "lo") == "127.0.0.1"
    with open_command("cameras", "127.0.0.1") as command:
        assert command.getsockname()[0] == "127.0.0.1"
    with open_multicast("cameras", "127.0.0.1", "239.255.42.99", 0) as data:
        assert data.getsockname()[0] == "239.255.42.99"
    with pytest.raises(DeviceError, match="not a multicast group"):
        open_multicast("cameras", "127.0.0.1", "192.168.1.10", 0)


@pytest.mark.parametrize(
    "keys",
    [
        {"markers": {"leg": 1}},
        {"angles": {"angles": {"body": "leg", "axis": [0, 1, 0]}}},
        {"joints": {"joints": {"to": "leg", "axis": [0, 1, 0]}}},
        {"euler": {"euler": {"body": "arm", "from": "leg"}}},
        {"bodies": ["arm", "arm"]},
        {"bitstream": "four"},
        {"group": "192.168.1.10"},
        {"group": "everybody"},
        {"lost_tracking_s": 1.0},
    ],
)
def test_settings_that_contradict_themselves_are_refused(keys):
    with pytest.raises(ValueError, match=next(iter(keys))):
        OptiTrackSettings.model_validate({"host": "127.0.0.1", **keys})
