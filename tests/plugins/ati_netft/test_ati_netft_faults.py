"""What can go wrong with a Net F/T box, each brought about by its emulator."""

import socket
from contextlib import closing

import numpy as np
import pytest
from emulated import emulated
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from labrun_plugins.ati_netft import emulator
from labrun_plugins.ati_netft.emulator import BoxState, TcpDoor, WebDoor
from labrun_plugins.simulated.ati_netft import SimulatedAtiNetFtSettings
from netft_bench import another_driver, failure, heard, is_gapless

from labrun.devices import DeviceError
from labrun.devices.emulation import EmulatorContext, EmulatorLog, Faults
from labrun.errors import LimitExceededError
from labrun.runner import RealClock

_FAULTS = (
    "silence", "drop", "truncate", "duplicate", "reorder", "late", "wrap", "saturate", "error", "condition", "stale",
    "unreachable", "restart", "reboot", "reset-counters",
)  # fmt: skip
FAST = {"host": "h", "rate_hz": 7000}


@pytest.fixture(scope="module")
def running():
    with emulated("ati-netft", {**FAST, "limits": {"force_n": 15, "torque_n_m": 0.9}}, name="ft") as bench:
        yield bench


@pytest.fixture
def bench(running):
    """Return an open driver in front of a box without faults."""
    running.driver.close()
    running.driver.open()
    yield running
    running.driver.close()
    for fault in _FAULTS:
        running.bench.clear("ft", fault)
    running.clear("none")


def comes_back(bench):
    """Tell whether closing and opening again brings samples, as a retry does."""
    bench.driver.close()
    bench.driver.open()
    bench.driver.start()
    return len(heard(bench, 0.3)) > 0


def test_silence_is_told_with_the_device_and_what_to_try(bench):
    bench.driver.start()
    heard(bench, 0.2)
    bench.inject("silence")
    error = failure(bench)
    assert isinstance(error, DeviceError)
    assert "device ft: no datagram for" in str(error)
    assert "check its power and network cable" in str(error)
    with pytest.raises(DeviceError, match="no datagram"):
        bench.driver.health()
    bench.clear("silence")
    assert comes_back(bench)


def test_a_stream_that_never_begins_is_told(bench):
    bench.inject("silence")
    bench.driver.start()
    assert "no datagram for" in str(failure(bench))


def test_datagrams_that_are_cut_short_are_counted_and_lost(bench):
    bench.driver.start()
    heard(bench, 0.2)
    bench.inject("truncate", 5)
    samples = heard(bench, 0.5)
    assert samples.lost == 5
    assert "5 malformed" in bench.driver.health().notes[0]


def test_nothing_but_cut_datagrams_is_told_as_what_it_is(bench):
    bench.driver.start()
    heard(bench, 0.2)
    bench.inject("truncate")
    assert "datagrams were of a wrong length" in str(failure(bench))
    bench.driver.stop()
    with pytest.raises(DeviceError, match=r"no sample from .* datagrams of a wrong length"):
        bench.driver.health()
    bench.clear("truncate")
    assert comes_back(bench)


def test_dropped_datagrams_are_counted_and_the_times_of_the_others_stay_right(bench):
    bench.driver.start()
    heard(bench, 0.2)
    bench.inject("drop", 0.05)
    samples = heard(bench, 0.6)
    bench.clear("drop")
    heard(bench, 0.1)
    assert 0.02 < samples.lost / (samples.lost + len(samples)) < 0.1
    ticks = round(7000 * (samples.device_time_s[-1] - samples.device_time_s[0])) + 1
    assert abs(ticks - len(samples) - samples.lost) <= 60  # those that wait at either end


def test_repeated_and_overtaken_datagrams_do_no_harm(bench):
    bench.driver.start()
    heard(bench, 0.2)
    bench.inject("duplicate", 40)
    bench.inject("reorder", 40)
    samples = heard(bench, 0.6)
    assert samples.lost == 0
    assert is_gapless(samples, 1 / 7000)
    counts = bench.driver.reception.sequencer.counts
    assert (counts.repeated, counts.restarts) == (40, 0)
    assert counts.overtaken > 0


def test_late_datagrams_keep_their_device_time(bench):
    bench.driver.start()
    before = heard(bench, 0.3)
    bench.inject("late", 0.2)
    after = heard(bench, 0.8)
    assert after.lost == 0
    assert is_gapless(after, 1 / 7000)
    late = (after.host_time_s - after.device_time_s)[-1] - (before.host_time_s - before.device_time_s).min()
    assert late > 0.15


def test_counters_that_wrap_do_not_disturb_the_stream(bench):
    bench.inject("wrap")
    bench.driver.start()
    samples = heard(bench, 0.4)
    assert samples.lost == 0
    assert len(samples) > 100
    assert is_gapless(samples, 1 / 7000)
    assert samples.device_time_s[-1] > 2**32 / 7000


def test_a_stream_that_is_numbered_anew_goes_on_and_is_counted(bench):
    bench.driver.start()
    heard(bench, 0.3)
    bench.inject("restart", 1)
    bench.wait_for("restarted")
    samples = heard(bench, 0.4)
    assert samples.lost == 0
    assert is_gapless(samples, 1 / 7000)
    assert "1 restarts of the stream" in bench.driver.health().notes[0]


@pytest.mark.parametrize("fault", ["reboot", "reset-counters"])
def test_a_box_that_was_restarted_is_a_fault(bench, fault):
    bench.driver.start()
    heard(bench, 0.4)
    bench.inject(fault, 1)
    error = failure(bench)
    assert isinstance(error, DeviceError)
    assert ("it was rebooted" if fault == "reset-counters" else "no datagram") in str(error)
    assert comes_back(bench)


def test_saturated_samples_are_kept_and_counted(bench):
    slow = another_driver(bench, rate_hz=500, limits={})
    with closing(slow.driver):
        slow.driver.open()
        slow.driver.start()
        assert heard(slow, 0.2).saturated == 0
        bench.inject("saturate")
        samples = heard(slow, 0.4)
        assert samples.saturated > len(samples) * 5  # those between the ones handed over count too
        assert samples.values[-1] == pytest.approx([20, 20, 60, 1, 1, 1])
        notes = " ".join(slow.driver.health().notes)
        assert "transducer saturated" in notes
        assert "force_z has reached 100 % of the range of SI-20-1" in notes


def test_an_error_of_the_box_discards_its_samples_and_is_told_in_words(bench):
    bench.driver.start()
    heard(bench, 0.2)
    before_s = bench.clock.now()
    bench.inject("error", 0x80000204)
    error = failure(bench)
    assert "strain gauge excitation too high, temperature out of range (status 80000204)" in str(error)
    assert "its samples are discarded" in str(error)
    assert bench.clock.now() - before_s < 5.0
    bench.driver.stop()
    with pytest.raises(DeviceError, match="reports an error"):
        bench.driver.health()
    bench.driver.close()
    with pytest.raises(DeviceError, match="reports an error"):
        bench.driver.open()
    bench.clear("error")
    assert comes_back(bench)


def test_a_tripped_monitor_condition_is_a_note(bench):
    bench.inject("condition")
    bench.driver.start()
    samples = heard(bench, 0.3)
    assert len(samples) > 0
    health = bench.driver.health()
    assert health.ok
    assert any("monitor condition" in note for note in health.notes)
    remarks = {remark.subject: remark for remark in bench.driver.examine()}
    assert remarks["status"].verdict == "warning"
    bench.clear("condition")
    host = bench.driver.settings
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plain:
        plain.sendto(bytes.fromhex("12 34 00 41 00 00 00 00"), (host.host, host.rdt_port))
    bench.wait_for("latch-reset")
    bench.driver.stop()
    assert bench.driver.health().notes == ("healthy (status 00000000)",)


def test_one_measurement_over_and_over_is_a_fault(bench):
    bench.driver.start()
    heard(bench, 0.2)
    bench.inject("stale")
    assert "repeats one and the same measurement" in str(failure(bench))


def test_another_program_that_takes_the_stream_is_named_as_a_possible_cause(bench):
    bench.driver.start()
    heard(bench, 0.2)
    host = bench.driver.settings
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
        thief.sendto(bytes.fromhex("12 34 00 02 00 00 00 00"), (host.host, host.rdt_port))
        error = failure(bench)
    bench.wait_for("stolen")
    assert "no other program reads the box" in str(error)
    assert comes_back(bench)


def test_a_stranger_cannot_put_samples_into_the_stream(bench):
    bench.driver.start()
    heard(bench, 0.2)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        port = bench.driver._source._socket._socket.getsockname()[1]
        for _ in range(50):
            stranger.sendto(b"\x7f" * 36, ("127.0.0.1", port))
    samples = heard(bench, 0.3)
    assert is_gapless(samples, 1 / 7000)
    assert (samples.lost, bench.driver.reception.sequencer.counts.restarts) == (0, 0)


def test_a_box_that_cannot_be_reached_is_told_and_comes_back(bench):
    bench.driver.start()
    heard(bench, 0.2)
    bench.inject("unreachable")
    assert "no datagram" in str(failure(bench))
    bench.driver.close()
    with pytest.raises(DeviceError, match=r"device ft: cannot read http://127\.0\.0\.1") as raised:
        bench.driver.open()
    assert "check its power and network cable" in str(raised.value)
    bench.clear("unreachable")
    assert comes_back(bench)


def test_a_load_beyond_the_limit_is_found_in_records_that_are_not_handed_over_too(bench):
    slow = another_driver(bench, rate_hz=10)
    with closing(slow.driver):
        slow.driver.open()
        slow.driver.start()
        heard(slow, 0.2)
        bench.inject("saturate")
        error = failure(slow)
    assert isinstance(error, LimitExceededError)
    assert "force_x 20 N is above the limit of 15 N" in str(error)


@pytest.mark.parametrize(
    ("fault", "message"),
    [("restart", "no datagram"), ("reorder", "pynetft has given up"), ("silence", "")],
)
def test_pynetft_as_the_client_ends_with_an_error_and_not_in_silence(bench, fault, message):
    other = another_driver(bench, client="pynetft", silence_ms=400)
    with closing(other.driver):
        other.driver.open()
        other.driver.start()
        assert len(heard(other, 1.2)) > 0
        bench.inject(fault, True if fault == "silence" else 1)
        error = failure(other)
    assert isinstance(error, DeviceError)
    assert message in str(error)
    assert "check its power and network cable" in str(error)
    bench.clear(fault)
    assert comes_back(other)
    other.driver.close()


def _doors(tmp_path):
    clock = RealClock()
    context = EmulatorContext(
        clock, np.random.default_rng(1), tmp_path, None, Faults(), log=EmulatorLog(None, clock)
    )
    return context, BoxState(context.log, context.faults)


def test_the_emulated_box_packs_the_golden_records():
    first = emulator._RECORD.pack(1, 4711, 0, 1_000_000, -2_000_000, 3_500_000, 1000, -500, 250)
    assert first == bytes.fromhex("000000010000126700000000000F4240FFE17B80003567E0000003E8FFFFFE0C000000FA")
    assert emulator._RECORD.pack(2, 4712, 0x80010000, *[0] * 6) == bytes.fromhex(
        "000000020000126880010000"
    ) + bytes(24)


@given(
    st.lists(
        st.one_of(st.binary(max_size=20), st.binary(min_size=6, max_size=6).map(lambda b: b"\x124" + b)),
        max_size=8,
    )
)
def test_the_emulated_box_obeys_any_datagram_or_ignores_it(tmp_path_factory, datagrams):
    context, _ = _doors(tmp_path_factory.getbasetemp())
    settings = SimulatedAtiNetFtSettings(host="h")
    box = emulator.AtiNetFtEmulator("ft", settings, context)
    for datagram in datagrams:
        box._obey(datagram, ("127.0.0.1", 9))
    known = [
        d
        for d in datagrams
        if len(d) == 8 and d[:2] == b"\x124" and int.from_bytes(d[2:4]) in (0, 2, 3, 0x41, 0x42)
    ]
    rejected = [line for line in context.log.lines if line["event"] == "rejected"]
    assert len(rejected) == len(datagrams) - len(known)


@hypothesis_settings(max_examples=150)
@given(st.one_of(st.binary(max_size=200), st.text(max_size=80).map(lambda t: f"GET /{t} HTTP/1.1".encode())))
def test_the_emulated_web_page_answers_any_request_line(tmp_path_factory, line):
    context, state = _doors(tmp_path_factory.getbasetemp())
    answer = WebDoor(context, "127.0.0.1", state).answer(line)
    assert answer.startswith(b"HTTP/1.1 ")
    assert 1 <= state.rate_hz <= 7000


@given(st.binary(min_size=20, max_size=20))
def test_the_emulated_tcp_port_answers_any_request_or_not(tmp_path_factory, request_bytes):
    context, state = _doors(tmp_path_factory.getbasetemp())
    assert len(TcpDoor(context, "127.0.0.1", state).answer(request_bytes)) in (0, 16, 24)
