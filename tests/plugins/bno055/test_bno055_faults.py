"""What can go wrong between a BNO055 and the runner, one fault a test, brought about on the wire."""

import numpy as np
import pytest
import serial
from emulated import emulated
from test_bno055_driver import KEYS, SCENE, other_driver, written

from labrun.errors import DeviceError

MADE = []


@pytest.fixture(scope="module")
def shared():
    with emulated("bno055", KEYS, name="imu", **SCENE) as made:
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


def reading(bench, **keys):
    driver = opened(bench, **keys)
    driver.start()
    bench.wait_until(lambda: len(driver.read()))
    return driver


def collect_some(bench, driver, count):
    """Return the next readings, at least so many: how long they take depends on what else the machine does."""
    values = []
    bench.wait_until(lambda: values.append(driver.read().values) or sum(map(len, values)) >= count, 10.0)
    return np.concatenate(values)


def test_no_answer_at_the_beginning(bench):
    bench.inject("silence")
    with pytest.raises(DeviceError, match=r"imu: does not answer[\s\S]*PS1 is high"):
        bench.driver.open()
    bench.clear("silence")
    bench.answers_again(bench.driver)


def test_no_answer_any_more(bench):
    driver = reading(bench)
    bench.inject("silence")
    with pytest.raises(
        DeviceError, match=r"imu: does not answer; so did 5 readings in a row[\s\S]*its cable"
    ):
        bench.read_until_it_fails(driver)
    with pytest.raises(DeviceError, match="does not answer"):
        driver.health()
    bench.clear("silence")
    bench.answers_again(driver)


def test_answers_that_come_too_late_are_not_taken_for_later_ones(bench):
    driver = reading(bench)
    bench.inject("late", 0.08)
    with pytest.raises(DeviceError, match="5 readings in a row"):
        bench.read_until_it_fails(driver)


def test_half_an_answer_costs_a_reading_or_a_few(bench):
    driver = reading(bench)
    bench.inject("half-frame", 1)
    got = bench.collect(driver, 0.6)
    assert got["lost"] >= 1
    assert len(got["values"]) > 10


@pytest.mark.parametrize("fault", ["random-byte", "length"])
def test_a_byte_too_many_or_too_few_is_thrown_away_with_its_reading(bench, fault):
    driver = reading(bench)
    bench.inject(fault, 2)
    got = bench.collect(driver, 0.8)
    assert got["lost"] >= 2
    assert len(got["values"]) > 10
    assert np.degrees(got["values"][:, 10].max()) < 2.0


def test_a_bad_line_all_the_time(bench):
    driver = reading(bench)
    bench.inject("random-byte")
    with pytest.raises(
        DeviceError, match=r"imu: answered with bytes that do not match the request[\s\S]*cable"
    ):
        bench.read_until_it_fails(driver)


def test_a_flipped_bit_in_the_answers_brings_no_orientation_that_cannot_be(bench):
    driver = reading(bench)
    bench.inject("corrupt", 15)
    values = []
    until_s = bench.clock.now() + 1.5
    try:
        while bench.clock.now() < until_s:
            bench.clock.sleep(0.02)
            values.append(driver.read().values)
    except DeviceError as error:  # five spoilt ones in a row may be among them
        assert "imu" in str(error)
    values = np.concatenate(values)
    np.testing.assert_allclose(np.linalg.norm(values[:, :4], axis=1), 1.0, atol=0.0101)
    # what a body could have done in the time since the last good reading passes: the line has no checksum
    assert np.degrees(values[:, 10].max()) < 60.0


def test_another_chip_answers(bench):
    bench.inject("wrong-id")
    with pytest.raises(
        DeviceError, match=r"imu: the device that answers is not a BNO055: its chip id is 86[\s\S]*this port"
    ):
        bench.driver.open()


def test_over_runs_are_hidden_by_asking_again(bench):
    bench.inject("overrun", 0.15)  # six in a row, which it does not hide, come once in 90 000 requests
    driver = reading(bench, rate_hz=20)
    collect_some(bench, driver, 15)
    counted = {remark.subject: remark for remark in driver.examine()}["over-runs"].message
    assert int(counted.split()[0]) > 0


def test_over_runs_without_end(bench):
    driver = reading(bench)
    bench.inject("overrun", 1.0)
    with pytest.raises(DeviceError, match=r"too busy to answer 6 times in a row \(bus over-run\)"):
        bench.read_until_it_fails(driver)
    bench.clear("overrun")
    bench.answers_again(driver)


def test_a_status_in_place_of_data_is_told_in_words(bench):
    driver = reading(bench)
    bench.inject("error", 2)
    with pytest.raises(DeviceError, match="answered a reading of register 14 with: 02, read failed"):
        bench.read_until_it_fails(driver)


def test_a_refused_set_up_is_told_in_words(bench):
    driver = opened(bench)
    driver.close()
    bench.inject("system-error", 3)
    with pytest.raises(
        DeviceError, match=r"fusion is not running: system status 1, error 3[\s\S]*off and on"
    ):
        driver.open()


def test_a_system_error_makes_it_unwell(bench):
    driver = opened(bench)
    bench.inject("system-error", 7)
    health = driver.health()
    assert not health.ok
    assert "system error 07" in health.notes


def test_unplugged_in_the_midst_of_a_run_and_plugged_in_again(bench):
    driver = reading(bench)
    bench.inject("unplug")
    with pytest.raises(DeviceError, match=r"imu: port .* was unplugged[\s\S]*labrun resume"):
        bench.read_until_it_fails(driver)
    driver.safe_stop()
    driver.close()
    with pytest.raises(DeviceError, match=r"cannot find the port[\s\S]*labrun doctor"):
        driver.open()
    bench.clear("unplug")
    bench.wait_until(lambda: len(bench.events("plugged")) > len(bench.events("unplugged")))
    bench.answers_again(driver)


def test_its_supply_fails_for_a_moment_and_the_next_start_sets_it_up_again(bench):
    driver = reading(bench)
    bench.inject("reset", 1)
    with pytest.raises(DeviceError, match=r"imu: (does not answer|its readings cannot be true)"):
        bench.read_until_it_fails(driver)
    driver.stop()
    began_s = bench.clock.now()
    driver.start()  # it may still boot
    assert (0x3D, b"\x08") in written(bench, began_s)
    bench.wait_until(lambda: len(driver.read()))


def test_a_chip_that_boots_is_waited_for(bench):
    bench.inject("reset", 1)
    bench.wait_for("reset")
    driver = opened(bench)
    assert driver.health().ok


def test_a_quaternion_that_is_none_for_a_tenth_of_a_second_is_a_fault(bench):
    driver = reading(bench)
    bench.inject("off")
    with pytest.raises(
        DeviceError, match=r"cannot be true for 0\.\d+ s: its quaternion has a length of 0\.5"
    ):
        bench.read_until_it_fails(driver)
    bench.clear("off")
    bench.answers_again(driver)


def test_one_impossible_jump_is_left_out(bench):
    driver = reading(bench)
    bench.inject("jump", 1)
    got = bench.collect(driver, 0.6)
    heading = np.degrees(np.angle(np.exp(1j * (got["values"][:, 4] - got["values"][0, 4]))))
    assert np.abs(heading).max() < 10
    assert got["lost"] >= 1


def test_a_heading_that_it_sets_anew_is_believed_and_told(bench):
    driver = reading(bench)
    before = bench.collect(driver, 0.2)["values"]
    bench.inject("anew", 90)
    after = bench.collect(driver, 0.6)["values"]
    turned = np.degrees(np.angle(np.exp(1j * (after[-1, 4] - before[-1, 4]))))
    assert abs(turned) == pytest.approx(90, abs=5)
    assert "jumps of its heading that it made itself: 1" in driver.health().notes
    bench.clear("anew")


def test_the_end_of_the_gyroscopes_range_is_counted(bench):
    driver = reading(bench)
    bench.inject("saturate")
    bench.clock.sleep(0.2)
    driver.read()
    got = bench.collect(driver, 0.3)
    assert got["saturated"] == len(got["values"]) > 0
    np.testing.assert_allclose(np.degrees(got["values"][-1, 7:10]), 2000)


def test_answers_byte_by_byte_are_put_together(bench):
    driver = reading(bench, rate_hz=20)
    bench.inject("fragment")
    driver.read()
    values = collect_some(bench, driver, 8)
    assert np.degrees(values[:, 10].max()) < 2.0


def test_another_program_holds_the_port(bench):
    port = bench.bench.settings["imu"]["port"]
    with (
        serial.Serial(port, 115_200, exclusive=True),
        pytest.raises(DeviceError, match=r"imu: another program holds .*[\s\S]*fuser"),
    ):
        bench.driver.open()
    bench.answers_again(bench.driver)
