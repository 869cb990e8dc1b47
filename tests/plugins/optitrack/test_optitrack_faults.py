"""Bad days: what the network and Motive may do in the middle of a trial, and what becomes of the measurement."""

import socket

import numpy as np
import pytest
from emulated import emulated
from labrun_plugins.optitrack import emulator_wire as wire
from optitrack_bench import BENCH, KEYS, at_least, collect, is_one_row_of_frames

from labrun.errors import DeviceError

DECOY_M = (1.0, 2.0, 3.0)


@pytest.fixture(scope="module")
def served():
    with emulated("optitrack", KEYS, **BENCH) as bench:
        bench.wait_until(
            lambda: _answers(bench.driver), within_s=60.0
        )  # a busy machine may compile its scene first
        yield bench


def _answers(driver):
    try:
        driver.open()
    except DeviceError:
        return False
    finally:
        driver.close()
    return True


@pytest.fixture
def bench(served):
    served.driver.open()
    served.driver.start()
    collect(served, at_least(10))
    yield served
    faults = [line for line in served.events("fault") if line["value"] is not None]
    for name in {line["name"] for line in faults}:
        served.clear(name)
    served.driver.close()


def _fails(bench, message):
    """Read until the driver gives up; return its error and the samples until then."""
    blocks = []

    def failed():
        try:
            blocks.append(bench.driver.read())
        except DeviceError as error:
            blocks.append(error)
            return True
        return False

    bench.wait_until(failed)
    error = blocks.pop()
    assert message in str(error)
    assert error.device == "cameras"
    assert error.hint
    return error, blocks


def _works_again(bench):
    bench.driver.close()
    bench.driver.open()
    bench.driver.start()
    assert is_one_row_of_frames(collect(bench, at_least(20)))


def test_silence_is_told_as_such_and_over_after_it(bench):
    bench.inject("silence")
    error, _ = _fails(bench, "nor does it answer")
    assert "cable" in error.hint
    bench.clear("silence")
    _works_again(bench)


def test_a_server_that_answers_but_streams_nothing_is_told_apart(bench):
    bench.inject("no-frames")
    error, _ = _fails(bench, "it answers, though")
    assert "live" in error.hint
    bench.clear("no-frames")
    _works_again(bench)


def test_a_server_that_forgot_its_client_is_asked_to_serve_again(bench):
    bench.inject("forget", 1e-9)
    bench.wait_for("forgotten")
    bench.clear("forget")
    assert is_one_row_of_frames(collect(bench, at_least(60)))


def test_lost_datagrams_are_counted(bench):
    collect(bench, at_least(1))
    bench.inject("drop", 0.2)
    samples = collect(bench, lambda samples: samples.lost >= 20)
    bench.clear("drop")
    assert is_one_row_of_frames(samples)
    assert len(samples) > samples.lost


@pytest.mark.parametrize("fault", ["duplicate", "reorder"])
def test_repeated_and_overtaking_datagrams_change_nothing(bench, fault):
    bench.inject(fault, 20)
    samples = collect(bench, at_least(90))
    assert is_one_row_of_frames(samples)
    if fault == "duplicate":
        assert any("repeated" in note for note in bench.driver.health().notes)
    # A machine with too much to do may let a straggler come too late; it is counted then.
    assert samples.lost <= 20


@pytest.mark.parametrize("fault", ["truncate", "half-frame", "short-section"])
def test_datagrams_cut_short_are_dropped_and_counted(bench, fault):
    bench.inject(fault, 15)
    samples = collect(bench, at_least(90))
    assert is_one_row_of_frames(samples)
    assert 10 <= samples.lost <= 15 + 5
    assert any("cut short" in note for note in bench.driver.health().notes)


def test_frames_in_another_layout_are_told_as_unreadable(bench):
    bench.inject("layout", "3.0")
    error, _ = _fails(bench, "do not fit NatNet 4.1")
    assert "bitstream" in error.hint
    bench.clear("layout")
    _works_again(bench)


def test_late_frames_show_in_the_time_of_receipt_alone(bench):
    before = collect(bench, at_least(50))
    bench.inject("late", 0.15)
    after = collect(bench, at_least(60))
    assert is_one_row_of_frames(after)
    delay_s = [np.median(block.host_time_s - block.device_time_s) for block in (before, after)]
    assert delay_s[1] - delay_s[0] > 0.1


def test_a_body_that_is_lost_gives_no_samples_and_then_an_error(bench):
    collect(bench, at_least(50))
    bench.inject("tracking-lost")
    error, blocks = _fails(bench, "body arm is not tracked")
    assert "lost_tracking_s" in error.hint
    assert sum(block.lost for block in blocks) >= 0.2 * 240 * 0.5
    for block in blocks:
        # Motive repeats the last pose to the bit; measurements never do.
        assert len(np.unique(block.values, axis=0)) == len(block)
    assert any("not tracked" in remark.message for remark in bench.driver.examine())
    assert bench.driver.health().ok  # Motive is well; a body may be hidden between trials
    bench.clear("tracking-lost")
    bench.driver.start()
    assert is_one_row_of_frames(collect(bench, at_least(20)))


def test_a_marker_that_is_hidden_is_no_measurement_either(bench):
    bench.inject("hidden-marker", "arm")
    _fails(bench, "has its marker 1 hidden")


def test_a_body_that_leaves_the_frames_is_named(bench):
    bench.inject("missing-body", "arm")
    _fails(bench, "body arm is not in the frames")
    bench.clear("missing-body")


def test_bodies_that_change_their_numbers_are_followed(bench):
    bench.inject("model-changed", 1)
    samples = collect(bench, at_least(90))
    assert is_one_row_of_frames(samples)
    assert samples.lost >= 1  # frames between the change and the new model are nobody's
    assert np.abs(samples.values[:, :3] - DECOY_M).min() > 0.5
    assert bench.driver.identify().details["bodies"] != "arm = 11"


@pytest.mark.parametrize(
    ("fault", "message"), [("edit-mode", "edit mode"), ("bitstream-changed", "changed the layout")]
)
def test_fault_bits_of_a_frame_end_the_measurement(bench, fault, message):
    bench.inject(fault)
    _fails(bench, message)
    assert not bench.driver.health().ok
    bench.clear(fault)
    _works_again(bench)


@pytest.mark.parametrize("fault", ["silence", "tracking-lost", "edit-mode"])
def test_what_came_before_a_fault_is_handed_over_first(bench, fault):
    collect(bench, at_least(1))
    bench.clock.sleep(0.3)
    bench.inject(fault)
    # As long as nobody reads, nobody is told: the samples of before and the reason have to wait.
    bench.clock.sleep(1.0)
    assert len(bench.driver.read()) > 10
    with pytest.raises(DeviceError, match="device cameras: "):
        bench.driver.read()


def test_a_fault_bit_that_passes_before_anybody_looks_is_told_all_the_same(bench):
    collect(bench, at_least(1))
    bench.inject("edit-mode")
    bench.clock.sleep(0.2)
    bench.clear("edit-mode")
    bench.clock.sleep(0.2)  # frames are measurements again, but nobody knows what happened in between
    with pytest.raises(DeviceError, match="edit mode"):
        for _ in range(3):
            bench.driver.read()


def test_a_new_count_of_frames_goes_on_once_the_server_is_known_to_be_the_same(bench):
    bench.inject("restart", 1)
    samples = collect(bench, at_least(90))
    assert is_one_row_of_frames(samples)
    assert 1 <= samples.lost < 150
    assert any("counted anew" in note for note in bench.driver.health().notes)


def test_a_count_that_wraps_is_no_gap(bench):
    bench.inject("wrap", 1)
    samples = collect(bench, at_least(90))
    assert is_one_row_of_frames(samples)
    assert samples.lost < 150


def test_another_server_at_the_same_address_is_told(bench):
    bench.inject("reboot", 3_312_787)
    error, _ = _fails(bench, "is another server than before")
    assert "clock 3312787 Hz, unicast, not Motive" in str(error)
    assert not bench.driver.health().ok
    _works_again(bench)
    assert bench.driver.identify().details["clock_hz"] == "3312787"


def test_datagrams_of_others_are_not_listened_to(bench):
    address = tuple(bench.events("connect")[-1]["address"])
    body = wire.RigidBody(11, DECOY_M, (0.0, 0.0, 0.0, 1.0))
    forged = wire.frame(wire.Content(10**6, bodies=[body], ticks=(1, 2, 3)), (4, 1))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.2", 0))
        for _ in range(5):
            other.sendto(forged, address)
    samples = collect(bench, at_least(60))
    assert is_one_row_of_frames(samples)
    assert samples.lost == 0
    assert any("127.0.0.2" in note for note in bench.driver.health().notes)


def test_garbage_from_the_server_itself_is_dropped_and_counted(bench):
    bench.inject("half-frame", True)  # answers as well as frames
    _fails(bench, "no frame for")
    bench.clear("half-frame")
    _works_again(bench)


def test_flipped_bits_end_in_samples_or_in_an_error_that_names_the_device(bench):
    """A flipped bit is not always noticed (UDP has its own checksum for that); it must never break the driver."""
    bench.inject("corrupt", 100)
    values = []

    def passed():
        try:
            values.append(bench.driver.read().values)
        except DeviceError as error:
            assert error.device == "cameras"
            return True
        return sum(map(len, values)) > 100

    bench.wait_until(passed)
    for block in values:
        assert np.isfinite(block).all()
    bench.clear("corrupt")
    _works_again(bench)
