"""What can go wrong between an FT300 and the runner, one fault a test, brought about on the wire."""

import numpy as np
import pytest
import serial
from emulated import emulated
from test_ft300_driver import PATIENT, other_driver

from labrun.errors import DeviceError

MADE = []


@pytest.fixture(scope="module")
def shared():
    with emulated("robotiq-ft300", PATIENT, name="wrench", scene="caudal-tank") as made:
        yield made


@pytest.fixture
def bench(shared):
    yield shared
    shared.restore()
    while MADE:
        MADE.pop().close()


def opened(bench, **keys):
    driver = other_driver(bench, **keys)
    MADE.append(driver)
    driver.open()
    return driver


def streaming(bench, **keys):
    driver = opened(bench, **keys)
    driver.start()
    bench.wait_until(lambda: len(driver.read()))
    return driver


def test_no_answer(bench):
    bench.inject("silence")
    with pytest.raises(DeviceError, match=r"wrench: does not answer[\s\S]*check its 24 V supply"):
        bench.driver.open()
    bench.clear("silence")
    bench.answers_again(bench.driver)


def test_another_modbus_address(bench):
    bench.inject("wrong-slave")
    with pytest.raises(DeviceError, match=r"does not answer[\s\S]*slave 9[\s\S]*slave_id of its table"):
        bench.driver.open()


def test_late_answers_are_waited_for(bench):
    bench.inject("late", 0.1)
    bench.driver.open()
    assert bench.driver.identify().serial == "FTS-1234"


def test_an_answer_that_comes_far_too_late_is_not_taken_for_the_next_one(bench):
    driver = opened(bench, stream=False, poll_hz=20)
    driver.start()
    bench.wait_until(lambda: len(driver.read()))
    bench.inject("late", 0.4)
    with pytest.raises(DeviceError, match=r"wrench: does not answer[\s\S]*check its 24 V supply"):
        bench.read_until_it_fails(driver)


def test_half_a_frame_costs_no_other_ones(bench):
    driver = streaming(bench)
    before = driver._source.parser.skipped_bytes
    bench.inject("half-frame", 1)
    got = bench.collect(driver, 0.9)
    assert driver._source.parser.skipped_bytes - before == 8
    assert got["lost"] <= 3


def test_half_an_answer_is_asked_for_again(bench):
    bench.inject("half-frame", 1)
    bench.driver.open()
    assert bench.driver.identify().firmware == "FTS-1.2.3"


def test_a_bad_checksum_in_the_stream_is_counted_and_no_wrong_value_comes_through(bench):
    driver = streaming(bench)
    before = driver._source.parser.skipped_bytes
    bench.inject("corrupt", 5)
    got = bench.collect(driver, 0.9)
    assert driver._source.parser.skipped_bytes - before == 5 * 16
    assert got["lost"] >= 3
    assert np.all(np.abs(got["values"] - np.median(got["values"], axis=0)) < [2, 2, 2, 0.1, 0.1, 0.1])
    assert "0 wrong checksums" not in driver.health().notes[0]
    driver.close()


def test_bad_checksums_all_the_time(bench):
    driver = streaming(bench, silence_ms=300)
    bench.inject("corrupt")
    with pytest.raises(DeviceError, match=r"wrench: no frame of its stream is right[\s\S]*shield"):
        bench.read_until_it_fails(driver)
    with pytest.raises(DeviceError, match="no frame of its stream is right"):
        driver.health()
    driver.close()
    with pytest.raises(DeviceError, match=r"wrong checksum|are not an answer"):
        driver.open()
    bench.clear("corrupt")
    bench.answers_again(driver)


def test_another_device_answers(bench):
    bench.inject("wrong-id")
    with pytest.raises(DeviceError, match=r"is not an FT300: its firmware is GRS-1\.2\.3[\s\S]*check port"):
        bench.driver.open()


def test_an_exception_code_is_told_in_words(bench):
    bench.inject("error")
    with pytest.raises(
        DeviceError, match=r"refused to read register 500: Modbus exception 02[\s\S]*firmware"
    ):
        bench.driver.open()


def test_unplugged_in_the_midst_of_a_run_and_plugged_in_again(bench):
    driver = streaming(bench)
    bench.inject("unplug")
    with pytest.raises(DeviceError, match=r"wrench: port .* was unplugged[\s\S]*labrun resume"):
        bench.read_until_it_fails(driver)
    driver.safe_stop()
    driver.close()
    with pytest.raises(DeviceError, match=r"cannot find the port[\s\S]*labrun doctor"):
        driver.open()
    bench.clear("unplug")
    bench.wait_until(lambda: len(bench.events("plugged")) > len(bench.events("unplugged")))
    driver.open()  # it streams on all the time: nobody has told it to stop
    assert driver.identify().details["was_still_streaming"] == "yes"
    bench.answers_again(driver)


def test_what_came_before_a_fault_is_handed_over_first(bench):
    driver = streaming(bench)
    bench.clock.sleep(0.3)
    bench.inject("unplug")
    bench.wait_until(lambda: not driver._listener.running)
    assert len(driver.read()) > 10
    with pytest.raises(DeviceError, match="was unplugged"):
        driver.read()
    driver.close()
    bench.clear("unplug")
    bench.wait_until(lambda: len(bench.events("plugged")) > len(bench.events("unplugged")))


def test_the_end_of_its_range_is_counted(bench):
    driver = streaming(bench)
    bench.inject("saturate")
    bench.clock.sleep(0.2)
    driver.read()
    got = bench.collect(driver, 0.3)
    assert got["saturated"] == len(got["values"]) > 0
    np.testing.assert_allclose(got["values"][-1], [300, 300, 300, 30, 30, 30])
    driver.close()


@pytest.mark.parametrize("stubborn", [0, 2])
def test_it_still_streams_when_a_run_connects_and_one_jam_may_not_be_enough(bench, stubborn):
    bench.inject("streaming", 1)
    if stubborn:
        bench.inject("stubborn", stubborn)
    bench.wait_for("stream")
    bench.driver.open()
    assert bench.driver.identify().details["was_still_streaming"] == "yes"
    assert bench.driver.health().ok
    assert len(bench.events("jam ignored")) >= stubborn
    if not stubborn:
        remarks = {remark.subject: remark for remark in bench.driver.examine()}
        assert remarks["left streaming"].verdict == "warning"


def test_it_never_stops_streaming(bench):
    bench.inject("streaming", 1)
    bench.inject("stubborn")
    bench.wait_for("stream")
    with pytest.raises(DeviceError, match=r"keeps streaming after 4 x 50 bytes FF[\s\S]*off and on"):
        bench.driver.open()


def test_a_stream_that_stops_is_lost_and_can_be_started_again(bench):
    driver = streaming(bench, silence_ms=300)
    bench.inject("restart", 1)
    with pytest.raises(
        DeviceError, match=r"its stream stopped: nothing for 0\.3\d* s \(100 frames/s[\s\S]*24 V"
    ):
        bench.read_until_it_fails(driver)
    driver.stop()
    driver.start()
    bench.wait_until(lambda: len(driver.read()))
    driver.close()


def test_by_default_a_stream_is_lost_after_160_ms():
    from labrun_plugins.robotiq_ft300.settings import RobotiqFt300Settings

    assert RobotiqFt300Settings(port="p").silence_ms == 160


def test_the_answer_to_a_start_may_get_lost_while_the_stream_comes(bench):
    driver = opened(bench)
    bench.inject("corrupt", 1)
    driver.start()
    bench.wait_until(lambda: len(driver.read()))
    driver.close()


def test_a_force_whose_bytes_are_those_of_the_header(bench):
    bench.inject("alias")
    driver = streaming(bench)
    got = bench.collect(driver, 0.5)
    assert len(got["values"]) > 20
    np.testing.assert_allclose(got["values"][:, 0], 200.0)
    assert got["lost"] == 0


@pytest.mark.parametrize(("fault", "value"), [("fragment", True), ("coalesce", 5), ("garbage", 20)])
def test_bytes_one_by_one_or_frames_in_lumps_or_among_others_lose_nothing(bench, fault, value):
    driver = opened(bench)
    bench.inject(fault, value)
    driver.start()
    got = bench.collect(driver, 1.0)
    assert len(got["values"]) > 60
    assert got["lost"] <= (2 if fault == "garbage" else 0)  # the line is too slow for frames and garbage
    assert np.all(np.diff(got["host_s"]) >= 0)


def test_frames_that_never_come_are_counted(bench):
    driver = streaming(bench)
    bench.inject("drop", 0.2)
    got = bench.collect(driver, 1.2)
    bench.clear("drop")
    rest = bench.collect(driver, 0.55)
    lost = got["lost"] + rest["lost"]
    frames = len(got["values"]) + len(rest["values"])
    expected = (rest["host_s"][-1] - got["host_s"][0]) * 100 + 1
    assert lost + frames == pytest.approx(expected, abs=8)  # on a busy machine the last one may be late
    assert lost > 12
    driver.close()


def test_another_program_holds_the_port(bench):
    port = bench.bench.settings["wrench"]["port"]
    with (
        serial.Serial(port, 19_200, exclusive=True),
        pytest.raises(DeviceError, match=r"wrench: another program holds .*[\s\S]*fuser"),
    ):
        bench.driver.open()
    bench.answers_again(bench.driver)
