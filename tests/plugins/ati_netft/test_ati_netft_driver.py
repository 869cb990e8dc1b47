"""The Net F/T driver against a box in another process, over loopback."""

import socket
import struct
from pathlib import Path

import numpy as np
import pytest
from emulated import emulated
from labrun_plugins.ati_netft.driver import AtiNetFt
from labrun_plugins.ati_netft.settings import AtiNetFtSettings
from netft_bench import another_driver, heard, is_gapless

from labrun.devices import DeviceContext, DeviceError, Sensor
from labrun.runner import RealClock

_HOST = {"host": "192.168.1.1"}
_RECORD = struct.Struct(">IIIiiiiii")


@pytest.fixture(scope="module")
def box():
    """Return one emulated box for all tests of this file; each makes its own driver."""
    with emulated("ati-netft", _HOST, name="ft", scene="caudal-tank") as bench:
        yield bench


@pytest.fixture
def opened(box):
    made = []

    def make(**keys):
        bench = another_driver(box, **keys)
        made.append(bench.driver)
        bench.driver.open()
        return bench

    yield make
    for driver in made:
        driver.close()


def asked(box, message, count=1):
    """Send a request from a plain socket; return what comes back."""
    settings = box.bench.table("ft").settings
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plain:
        plain.settimeout(3.0)
        plain.connect((settings["host"], settings["rdt_port"]))
        plain.send(bytes.fromhex(message))
        return [plain.recv(2000) for _ in range(count)]


def test_the_emulated_box_answers_the_golden_requests_with_golden_layouts(box):
    (answer,) = asked(box, "12 34 00 02 00 00 00 01")
    assert len(answer) == 36
    sequence, _, status, *counts = _RECORD.unpack(answer)
    assert (sequence, status, len(counts)) == (1, 0, 6)
    stream = asked(box, "12 34 00 02 00 00 00 05", 5)
    assert [_RECORD.unpack(datagram)[0] for datagram in stream] == [1, 2, 3, 4, 5]
    (many,) = asked(box, "12 34 00 03 00 00 00 28")
    assert len(many) == 1440
    assert [_RECORD.unpack_from(many, 36 * i)[0] for i in range(40)] == list(range(1, 41))
    settings = box.bench.table("ft").settings
    with socket.create_connection((settings["host"], settings["tcp_port"]), 3.0) as tcp:
        tcp.sendall(b"\x01" + bytes(19))
        golden = "12 34 02 04 00 0F 42 40 00 00 03 E8 00 03 00 03 00 09 00 3D 00 3D 00 3D"
        assert tcp.recv(100) == bytes.fromhex(golden)
        tcp.sendall(bytes(20))
        assert struct.unpack(">HH6h", tcp.recv(100))[:2] == (0x1234, 0)


def test_bias_makes_the_box_read_zero_and_the_driver_never_sends_it(box, opened):
    bench = opened(rate_hz=7000)
    bench.driver.start()
    heard(bench, 0.1)
    bench.driver.stop()
    assert not box.events("bias")
    loaded = _RECORD.unpack(asked(box, "12 34 00 02 00 00 00 01")[0])[3:]
    assert max(map(abs, loaded)) > 100_000  # the offset it woke up with
    settings = box.bench.table("ft").settings
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plain:
        plain.sendto(bytes.fromhex("12 34 00 42 00 00 00 00"), (settings["host"], settings["rdt_port"]))
    box.wait_for("bias")
    assert max(map(abs, _RECORD.unpack(asked(box, "12 34 00 02 00 00 00 01")[0])[3:])) < 100_000


@pytest.mark.parametrize("keys", [{}, {"mode": "buffered"}, {"client": "pynetft"}])
def test_seven_thousand_samples_a_second_arrive_without_a_gap(opened, keys):
    bench = opened(rate_hz=7000, **keys)
    assert isinstance(bench.driver, Sensor)
    bench.driver.start()
    samples = heard(bench, 0.6)
    bench.driver.health()
    bench.driver.stop()
    assert samples.lost == 0
    assert len(samples) > 1000
    assert is_gapless(samples, 1 / 7000)
    assert (np.diff(samples.host_time_s) >= 0).all()
    assert samples.host_time_s[-1] <= bench.clock.now()
    assert np.isfinite(samples.values).all()


def test_the_box_keeps_its_rate_and_every_fourteenth_record_is_handed_over(opened, box):
    bench = opened(rate_hz=500)
    assert bench.driver.rate_hz == pytest.approx(500.0)
    bench.driver.start()
    samples = heard(bench, 0.4)
    assert is_gapless(samples, 1 / 500)
    assert samples.lost == 0
    assert "7000" in bench.driver.identify().details["box_rate_hz"]
    assert "one record in 14" in bench.driver.identify().details["decimation"]
    assert not box.events("command")


def test_the_box_is_set_to_a_rate_only_when_asked_to(opened, box):
    bench = opened(rate_hz=1000, set_rate=True)
    assert [line["comrdtrate"] for line in box.events("command")] == [1000]
    bench.driver.start()
    samples = heard(bench, 0.5)
    bench.driver.stop()
    assert is_gapless(samples, 1 / 1000)
    assert bench.driver.identify().details["decimation"] == "none"
    with pytest.raises(DeviceError, match="sends 1000 samples/s, but rate_hz = 2000") as raised:
        opened(rate_hz=2000)
    assert "set_rate = true" in str(raised.value)
    box.inject("ignore-settings")
    with pytest.raises(DeviceError, match="was set to send 7000 samples/s, and still says 1000"):
        opened(rate_hz=7000, set_rate=True)
    box.clear("ignore-settings")
    opened(rate_hz=7000, set_rate=True)


def test_identify_says_what_analysis_needs(opened):
    identity = opened().driver.identify()
    assert (identity.model, identity.serial) == ("Net F/T (emulated)", "FT00000")
    details = identity.details
    assert (details["force_unit"], details["torque_unit"]) == ("N", "N-mm")
    assert (details["counts_per_force_unit"], details["counts_per_torque_unit"]) == ("1e+06", "1000")
    assert details["own_address"] == "127.0.0.1"


def test_health_without_a_stream_asks_the_box_and_with_one_reports_on_it(opened):
    bench = opened()
    assert bench.driver.health().notes == ("healthy (status 00000000)",)
    bench.driver.start()
    heard(bench, 0.2)
    health = bench.driver.health()
    assert health.ok
    assert "0 lost (0 of them in this computer)" in health.notes[0]


def test_examine_measures_the_rate_and_compares_both_doors(opened):
    remarks = {remark.subject: remark for remark in opened().driver.examine()}
    assert remarks["rate"].message.endswith("500 samples/s are handed over")
    assert remarks["losses"].verdict == remarks["status"].verdict == "ok"
    assert "1000 per N-mm" in remarks["units"].message
    (tcp,) = [remark for subject, remark in remarks.items() if subject.startswith("TCP")]
    assert tcp.verdict == "ok"


def test_a_stop_reaches_the_box_from_safe_stop_stop_and_close(opened, box):
    bench = opened()
    for end in (bench.driver.safe_stop, bench.driver.stop, bench.driver.close):
        bench.driver.open()
        bench.driver.start()
        heard(bench, 0.1)
        before_s = bench.clock.now()
        end()
        box.wait_for("stop", after_s=before_s)
        end()
    bench.driver.open()
    with pytest.raises(DeviceError, match="is not streaming"):
        bench.driver.read()


def test_a_silence_after_safe_stop_is_no_fault(opened):
    bench = opened(silence_ms=50)
    bench.driver.start()
    heard(bench, 0.3)
    bench.driver.safe_stop()
    heard(bench, 0.4)
    assert bench.driver.health().ok


def test_the_named_interface_is_used_and_another_name_is_refused(opened):
    assert opened(interface="lo").driver.identify().details["own_address"] == "127.0.0.1"
    with pytest.raises(DeviceError, match="no interface 'eth77'") as raised:
        opened(interface="eth77")
    assert "lo" in str(raised.value)
    with pytest.raises(DeviceError, match="is not an address of this computer"):
        opened(interface="203.0.113.9")


def test_no_socket_of_a_stream_listens_on_all_interfaces(opened):
    bench = opened()
    bench.driver.start()
    heard(bench, 0.1)
    port = bench.driver.settings.rdt_port
    lines = [line.split() for line in Path("/proc/self/net/udp").read_text().splitlines()[1:]]
    ours = [line for line in lines if line[2].endswith(f":{port:04X}")]
    assert ours
    assert all(line[1].startswith("0100007F:") for line in ours)


def test_what_is_felt_is_what_the_scene_has_within_noise(opened, box):
    bench = opened(rate_hz=1000)
    bench.driver.start()
    values = heard(bench, 0.5).values
    bench.driver.stop()
    assert (values.std(axis=0) < [0.05, 0.05, 0.1, 0.002, 0.002, 0.002]).all()
    assert (np.abs(values.mean(axis=0)) < [4.0, 4.0, 12.0, 0.2, 0.2, 0.2]).all()


def test_a_driver_that_is_not_open_says_so_and_closes_without_complaint():
    driver = AtiNetFt("ft", AtiNetFtSettings(host="h"), DeviceContext(RealClock(), np.random.default_rng(1)))
    assert not driver.health().ok
    driver.safe_stop()
    driver.close()
    with pytest.raises(DeviceError, match="device ft: is not open"):
        driver.start()
