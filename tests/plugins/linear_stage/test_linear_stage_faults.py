"""One fault after the other, brought about by the emulator: what the driver says, and that it comes back."""

import contextlib

import numpy as np
import pytest
import serial
from emulated import emulated
from stage_bench import commands, stage_settings

from labrun.devices import DeviceError
from labrun.errors import LimitExceededError


@pytest.fixture(scope="module")
def running():
    with emulated(
        "linear-stage", stage_settings(watchdog_ms=400), name="stage", scene="beam-bench",
        scene_settings={"noise": 0},
    ) as bench:  # fmt: skip
        yield bench  # 400 ms: what is tested here is not how loaded the machine is


@pytest.fixture
def bench(running):
    """The stage, open and streaming; whatever a test did to it is over for the next one."""
    since = len(running.events("fault"))
    running.driver.open()
    running.driver.start()
    yield running
    last = {line["name"]: line["value"] for line in running.events("fault")[since:]}
    for fault in [name for name, value in last.items() if value]:
        running.clear(fault)
    running.driver.safe_stop()
    running.driver.close()


def collect(bench, duration_s):
    blocks = []
    until_s = bench.clock.now() + duration_s
    while bench.clock.now() < until_s:
        bench.clock.sleep(0.02)
        blocks.append(bench.driver.read())
    return blocks


def failure(bench, within_s=3.0):
    """Return what the driver raises when it is asked again and again, as a runner does."""
    deadline_s = bench.clock.now() + within_s
    while bench.clock.now() < deadline_s:
        try:
            bench.driver.read()
            bench.driver.health()
        except DeviceError as error:
            return error
        bench.clock.sleep(0.02)
    raise AssertionError("the driver noticed nothing")


def is_well(bench):
    """Tell whether it says so; an answer that is late on a loaded machine may be asked for once more."""
    try:
        return bench.driver.health().ok
    except DeviceError as error:
        assert "does not answer ST" in str(error), error
        return False


def comes_back(bench):
    bench.driver.close()
    bench.driver.open()
    bench.driver.start()
    blocks = collect(bench, 0.3)
    assert sum(len(block) for block in blocks) > 5
    bench.wait_until(lambda: is_well(bench))


def assert_explained(error, what, hint):
    assert str(error).startswith("device stage: ")
    assert what in str(error)
    assert error.hint is not None and hint in error.hint


def test_silence_is_no_answer_and_ends(bench):
    bench.inject("silence")
    assert_explained(failure(bench), "does not answer", "cable")
    bench.clear("silence")
    comes_back(bench)


def test_damaged_lines_are_lost_samples_and_nothing_else(bench):
    collect(bench, 0.1)
    bench.inject("corrupt", 6)
    blocks = collect(bench, 0.6)
    lost = sum(block.lost for block in blocks)
    values = np.concatenate([block.values for block in blocks])
    assert 1 <= lost <= 6  # some of the six were answers to signs of life
    assert np.ptp(values[:, 0]) < 1e-6
    assert np.ptp(values[:, 1]) < 0.02
    bench.wait_until(lambda: is_well(bench))


def test_half_a_line_spoils_no_more_than_its_neighbour(bench):
    collect(bench, 0.1)
    bench.inject("half-frame", 3)
    assert 1 <= sum(block.lost for block in collect(bench, 0.5)) <= 6
    bench.wait_until(lambda: is_well(bench))


def test_several_lines_at_once_are_the_same_lines(bench):
    bench.inject("coalesce", 3)
    collect(bench, 0.1)
    blocks = collect(bench, 0.5)
    assert sum(len(block) for block in blocks) > 15
    assert sum(block.lost for block in blocks) == 0


def test_an_answer_byte_by_byte_is_an_answer(bench):
    bench.driver.stop()  # half a millisecond between two bytes is too slow for 80 samples a second
    bench.inject("fragment")
    for _ in range(3):
        bench.wait_until(lambda: is_well(bench))
    bench.clear("fragment")
    bench.driver.start()
    assert sum(len(block) for block in collect(bench, 0.3)) > 5


def test_a_late_answer_is_waited_for(bench):
    bench.inject("late", 0.05)
    bench.wait_until(lambda: is_well(bench))
    collect(bench, 0.2)


def test_an_answer_with_another_number_is_not_taken(bench):
    bench.inject("wrong-id", 1)
    bench.wait_until(lambda: is_well(bench))
    bench.inject("stale", 2)
    bench.wait_until(lambda: is_well(bench))


def test_samples_that_come_twice_or_out_of_order_are_taken_once(bench):
    collect(bench, 0.1)
    bench.inject("duplicate", 4)
    bench.inject("reorder", 3)
    device_s = np.concatenate([block.device_time_s for block in collect(bench, 0.6)])
    assert np.all(np.diff(device_s) > 0.01)


def test_samples_that_never_came_are_counted_by_their_numbers(bench):
    collect(bench, 0.1)
    bench.inject("skip", 5)
    assert sum(block.lost for block in collect(bench, 0.4)) == 5


def test_device_time_goes_on_when_the_microseconds_wrap(bench):
    bench.inject("wrap", 0.3)
    bench.driver.start()
    device_s = np.concatenate([block.device_time_s for block in collect(bench, 0.8)])
    assert device_s[0] < 2**32 * 1e-6 < device_s[-1]
    np.testing.assert_allclose(np.diff(device_s), 0.0125, atol=1e-4)


def test_a_force_beyond_its_limit_stops_the_board_first_and_it_can_be_backed_out_of(bench):
    driver = bench.driver
    driver.travel(0.015, 0.003)
    bench.wait_until(lambda: driver.position_m() > 2e-4)
    bench.inject("overload", 8.0)
    error = failure(bench)
    assert_explained(error, "force", "look at the be")
    assert isinstance(error, LimitExceededError)
    stop = bench.wait_for("stop", after_s=0.0)
    assert "FORCE" in {line["how"] for line in bench.events("stop")}
    assert stop is not None
    last_s = bench.events("command")[-1]["time_s"]
    bench.clear("overload")
    comes_back(bench)
    assert driver.position_m() == pytest.approx(
        bench.events("still")[-1]["position_mm"] * 1e-3 - 2e-3, abs=1e-5
    )
    assert all(line["word"] != "HOME" for line in commands(bench, after_s=last_s + 1e-3))


def test_an_end_switch_in_the_midst_of_the_way_stops_it(bench):
    driver = bench.driver
    driver.travel(0.015, 0.003)
    bench.wait_until(lambda: driver.position_m() > 2e-4)
    bench.inject("end-switch", "high")
    assert_explained(failure(bench), "upper end switch", "home it again")
    assert any(line["how"] == "HIGH" for line in bench.events("stop"))
    bench.clear("end-switch")
    comes_back(bench)


def test_an_amplifier_that_gives_nothing_is_told_apart_from_a_dead_line(bench):
    bench.inject("not-ready")
    assert_explained(failure(bench), "HX711", "wires")
    bench.clear("not-ready")
    comes_back(bench)


def test_a_stage_that_loses_its_load_cell_on_the_way_is_stopped_by_its_board(bench):
    bench.driver.travel(0.015, 0.003)
    bench.wait_until(lambda: bench.driver.position_m() > 2e-4)
    begun_s = bench.clock.now()
    bench.inject("not-ready")
    assert_explained(failure(bench), "HX711", "wires DOUT and SCK")
    assert "CELL" in {line["how"] for line in bench.events("stop") if line["time_s"] > begun_s}
    with pytest.raises(DeviceError, match="HX711"):
        bench.driver.travel(0.0, 0.003)
    bench.clear("not-ready")
    comes_back(bench)


def test_a_board_that_restarts_is_homed_anew(bench):
    bench.inject("restart")
    assert_explained(failure(bench), "restarted", "supply")
    bench.clock.sleep(0.1)
    before = len(commands(bench, "HOME"))
    comes_back(bench)
    assert len(commands(bench, "HOME")) == before + 1


def test_a_watchdog_that_expires_is_told_and_armed_again(bench):
    bench.driver.travel(0.01, 0.003)
    bench.inject("watchdog")
    assert_explained(failure(bench), "watchdog", "watchdog_ms")
    assert bench.wait_for("stop", after_s=bench.wait_for("watchdog")["time_s"] - 1e-3)["how"] == "watchdog"
    comes_back(bench)


def test_a_refused_target_ends_the_motion_with_the_boards_reason(bench):
    bench.inject("error", "HW,DRIVER")
    with pytest.raises(DeviceError, match=r"stage.*hardware is at fault \(DRIVER\)"):
        bench.driver.travel(0.001, 0.001)
    bench.clear("error")


def test_a_plug_that_is_pulled_is_told_and_back_in_it_goes_on(bench):
    bench.inject("unplug")
    assert_explained(failure(bench), "unplugged", "cable")
    with pytest.raises(DeviceError, match="cannot find the port"):
        bench.driver.open()
    bench.clear("unplug")
    bench.wait_until(lambda: bench.events("plugged")[-1]["time_s"] > bench.events("unplugged")[-1]["time_s"])
    comes_back(bench)


def test_another_program_on_the_port_is_named_as_what_it_is(bench):
    bench.driver.close()
    port = bench.bench.table("stage").settings["port"]
    with (
        contextlib.closing(serial.Serial(port, 115200, exclusive=True)),
        pytest.raises(DeviceError, match=r"another program holds(.|\n)*fuser"),
    ):
        bench.driver.open()


def test_a_clipped_reading_is_saturated_whether_the_board_flags_it_or_not():
    settings = stage_settings(limits={}, home_on_open=False)
    with emulated("linear-stage", settings, name="stage", scene="beam-bench") as bench:
        bench.driver.open()
        for fault in (True, "unflagged"):
            bench.inject("saturate", fault)
            bench.clock.sleep(0.05)
            bench.driver.start()
            blocks = collect(bench, 0.2)
            bench.driver.stop()
            count = sum(len(block) for block in blocks)
            assert count > 3
            assert sum(block.saturated for block in blocks) == count
