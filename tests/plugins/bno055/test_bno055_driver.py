"""The BNO055's driver against its emulator, in another process."""

import os
import pty
import tty

import numpy as np
import pytest
from emulated import emulated
from labrun_plugins.bno055.driver import Bno055
from labrun_plugins.bno055.settings import Bno055Settings

from labrun.devices import DeviceContext, Sensor
from labrun.errors import DeviceError

KEYS = {"port": "/dev/ttyUSB1", "mounted_on": "base"}
SCENE = {"scene": "spm-stabiliser", "scene_settings": {"base_tilt_deg": 0.0, "noise": 0.0}}
OFFSETS = "FE FF 0C 00 1A 00 2E 01 B8 00 5F FF FF FF FE FF 01 00 E8 03 A3 02"


@pytest.fixture(scope="module")
def bench():
    with emulated("bno055", KEYS, name="imu", **SCENE) as made:
        yield made


@pytest.fixture
def opened(bench):
    bench.driver.open()
    yield bench.driver
    bench.driver.close()


def other_driver(bench, **keys):
    made = Bno055Settings(**{**KEYS, **bench.bench.settings["imu"], **keys})
    return Bno055("imu", made, DeviceContext(bench.clock, np.random.default_rng(1)))


def written(bench, after_s=0.0):
    lines = [line for line in bench.events("write") if line["time_s"] >= after_s]
    return [(line["register"], bytes.fromhex(line["data"].replace(" ", ""))) for line in lines]


def test_it_is_a_sensor_and_says_what_it_is(opened):
    assert isinstance(opened, Sensor)
    identity = opened.identify()
    assert identity.model == "Bosch BNO055"
    assert identity.firmware == "03.11"
    assert identity.details["ids"] == "A0 FB 32 0F"
    assert identity.details["mode"] == "imu"
    assert identity.details["calibration_restored"] == "no"
    health = opened.health()
    assert health.ok
    assert health.temperature_c == 25.0
    assert health.notes[0].startswith("calibration: system ")


def test_it_is_set_up_in_the_order_of_the_data_sheet(bench):
    began_s = bench.clock.now()
    driver = other_driver(bench, offsets=OFFSETS, mode="ndof", external_crystal=True)
    driver.open()
    identity = driver.identify()
    driver.close()
    assert written(bench, began_s) == [
        (0x07, b"\x00"),
        (0x3D, b"\x00"),
        (0x3B, b"\x00"),
        (0x3F, b"\x80"),
        (0x55, bytes.fromhex(OFFSETS)),
        (0x3D, b"\x0c"),
    ]
    assert identity.details["calibration_offsets"] == OFFSETS
    assert identity.details["calibration_restored"] == "yes"


def test_its_readings_are_complete_in_order_and_those_of_a_level_body(bench, opened):
    opened.start()
    got = bench.collect(opened, 1.5)
    health = opened.health()
    opened.stop()
    count = len(got["host_s"])
    # At 100 Hz some readings fall out on a machine with other things to do; what fell out is counted.
    assert count > 75
    assert 120 <= count + got["lost"] <= 165
    assert got["saturated"] == 0
    assert np.all(np.diff(got["host_s"]) > 0)
    np.testing.assert_array_equal(got["host_s"], got["device_s"])
    np.testing.assert_allclose(np.linalg.norm(got["values"][:, :4], axis=1), 1.0, atol=1e-3)
    # glued on 0.3 deg askew in either direction
    assert np.degrees(np.abs(got["values"][:, 5:7]).max()) < 1.5
    assert np.degrees(got["values"][:, 10].max()) < 2.0
    assert np.degrees(got["values"][:, 7:10].std(axis=0)).max() < 0.2
    assert "readings" in health.notes[1]


def test_a_slower_rate_is_kept(bench):
    driver = other_driver(bench, rate_hz=20)
    assert driver.rate_hz == 20
    driver.open()
    driver.start()
    got = bench.collect(driver, 1.0)
    driver.close()
    assert 14 <= len(got["host_s"]) + got["lost"] <= 24


def test_it_can_be_stopped_and_started_and_asked_in_the_meantime(bench, opened):
    opened.start()
    bench.wait_until(lambda: len(opened.read()))
    opened.safe_stop()
    opened.stop()
    opened.stop()
    assert opened.health().ok
    with pytest.raises(DeviceError, match=r"is not streaming[\s\S]*start\(\) comes before"):
        opened.read()
    began_s = bench.clock.now()
    opened.start()
    bench.wait_until(lambda: len(block := opened.read()) and block.host_time_s[0] >= began_s)
    assert written(bench, began_s) == []  # it is as it was set up: its fusion goes on undisturbed
    opened.close()
    assert not opened.health().ok


def test_probe_only_reads_and_finds_it(bench):
    began_s = bench.clock.now()
    port = bench.bench.settings["imu"]["port"]
    # A busy machine may let the short time-outs of a probe pass; a person would ask again, too.
    probe = next(filter(None, (Bno055.probe(port) for _ in range(5))), None)
    assert probe is not None
    assert probe.model == "Bosch BNO055"
    assert written(bench, began_s) == []


def test_probe_finds_nothing_where_nobody_answers():
    master, slave = pty.openpty()
    for end in (master, slave):
        tty.setraw(end)
    assert Bno055.probe(os.ttyname(slave)) is None
    assert os.read(master, 100) == bytes.fromhex("AA 01 00 07")
    os.close(master)
    os.close(slave)


def test_examine_judges_rate_numbers_and_calibration(bench, opened):
    bench.clock.sleep(2.0)  # the gyroscope takes that long
    remarks = {remark.subject: remark for remark in opened.examine()}
    assert remarks["identity"].verdict == "ok"
    assert remarks["over-runs"].verdict == "ok"
    assert remarks["gravity"].verdict == "ok"
    assert "agree with its quaternion" in remarks["angles"].message
    assert remarks["calibration"].advice.startswith("to keep it, in the device's table: offsets = ")
    text = remarks["calibration"].advice.split('"')[1]
    assert len(bytes.fromhex(text)) == 22
    remarks = {remark.subject: remark for remark in opened.examine()}
    assert remarks["calibration"].verdict == "warning"  # it began anew when its offsets were read


def test_angles_come_from_the_quaternion_whatever_the_chip_makes_of_its_own(bench, opened):
    opened.start()
    before = bench.collect(opened, 0.3)["values"][:, 4:7]
    bench.inject("own-angles")
    after = bench.collect(opened, 0.3)["values"][:, 4:7]
    opened.stop()
    bench.clear("own-angles")
    apart = np.angle(np.exp(1j * (after.mean(axis=0) - before.mean(axis=0))))
    assert np.degrees(np.abs(apart)).max() < 0.5
