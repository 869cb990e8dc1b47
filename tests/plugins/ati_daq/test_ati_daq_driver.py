"""The driver of a sensor on a card, with voltages from another process."""

import json
import socket
import struct
from contextlib import closing

import numpy as np
import pytest
from cal_files import cal_text
from emulated import EmulatedDevice, emulated
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.ati_daq import emulator
from labrun_plugins.ati_daq.driver import AtiDaq
from labrun_plugins.ati_daq.settings import AtiDaqSettings
from labrun_plugins.rigs.caudal_fin.scene import CaudalTank
from labrun_plugins.simulated.ati_daq import SimulatedAtiDaq

from labrun.devices import DeviceContext, DeviceError, Samples, Sensor
from labrun.devices.emulation import EmulatorContext, EmulatorLog, Faults
from labrun.runner import RealClock, SimulatedClock

_FAULTS = (
    "silence", "overrun", "saturate", "open-gauge", "nonsense", "restart", "unplug", "drop", "half-frame", "late",
)  # fmt: skip


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    path = tmp_path_factory.mktemp("cal") / "FT98765.cal"
    text = cal_text(torque_unit="N-mm")
    for in_n_m, in_n_mm in (('max="1.0"', 'max="1000"'), ('"80.0"', '"0.08"'), ('"75.0"', '"0.075"')):
        text = text.replace(in_n_m, in_n_mm)
    path.write_text(text)
    keys = {"calibration_file": str(path), "rate_hz": 2000}
    with emulated("ati-daq", keys, name="balance", scene="caudal-tank") as bench:
        yield bench


@pytest.fixture
def bench(card):
    card.driver.close()
    card.driver.open()
    yield card
    card.driver.close()
    for fault in _FAULTS:
        card.bench.clear("balance", fault)
    card.clear("none")


def another_driver(bench, **keys):
    settings = AtiDaqSettings.model_validate({**bench.bench.table("balance").settings, **keys})
    clock = RealClock()
    driver = AtiDaq("balance", settings, DeviceContext(clock, np.random.default_rng(1)))
    return EmulatedDevice("balance", driver, clock, bench.bench)


def heard(bench, duration_s):
    blocks, until_s = [], bench.clock.now() + duration_s
    while bench.clock.now() < until_s:
        bench.clock.sleep(0.02)
        blocks.append(bench.driver.read())
    return Samples.join(blocks, 6)


def failure(bench, within_s=5.0):
    until_s = bench.clock.now() + within_s
    while bench.clock.now() < until_s:
        bench.clock.sleep(0.01)
        try:
            bench.driver.read()
        except DeviceError as error:
            return str(error)
    return ""


def comes_back(bench):
    bench.driver.close()
    bench.driver.open()
    bench.driver.start()
    return len(heard(bench, 0.3)) > 0


def test_samples_come_at_the_cards_rate_without_a_gap(bench):
    assert isinstance(bench.driver, Sensor)
    bench.driver.start()
    samples = heard(bench, 0.6)
    assert (samples.lost, samples.saturated) == (0, 0)
    assert len(samples) > 400
    np.testing.assert_allclose(np.diff(samples.device_time_s), 1 / 2000, rtol=1e-6)
    assert (np.diff(samples.host_time_s) >= 0).all()
    assert samples.host_time_s[-1] <= bench.clock.now()


def test_loads_are_those_of_the_scene_beside_a_constant_offset(bench):
    bench.driver.start()
    values = heard(bench, 0.5).values
    bench.driver.stop()
    assert (values.std(axis=0) < [0.05, 0.05, 0.1, 0.002, 0.002, 0.002]).all()


def test_a_bias_in_volts_is_taken_off_and_can_be_put_back(bench):
    bias = (0.3, -0.2, 0.1, -0.4, 0.05, 0.25)
    other = another_driver(bench, bias_v=bias)
    with closing(other.driver):
        bench.driver.start()
        plain = heard(bench, 0.3).values.mean(axis=0)
        bench.driver.stop()
        other.driver.open()
        other.driver.start()
        biased = heard(other, 0.3).values.mean(axis=0)
        details = other.driver.identify().details
    matrix = np.array(json.loads(details["matrix_si_per_v"]))
    assert tuple(json.loads(details["bias_v"])) == bias
    np.testing.assert_allclose(biased + matrix @ bias, plain, atol=0.05)


def test_identify_names_sensor_card_and_calibration(bench):
    identity = bench.driver.identify()
    assert (identity.model, identity.serial) == ("ATI Mini40", "FT98765")
    assert identity.details["card"] == "NI-emulated"
    assert identity.details["HWTempComp"] == "True"
    assert identity.details["TorqueUnits"] == "N-mm"


def test_examine_reports_rate_losses_voltages_and_calibration(bench):
    remarks = {remark.subject: remark for remark in bench.driver.examine()}
    assert remarks["losses"].verdict == remarks["voltages"].verdict == "ok"
    assert "FT98765" in remarks["calibration"].message
    bench.inject("open-gauge")
    remarks = {remark.subject: remark for remark in bench.driver.examine()}
    assert remarks["voltages"].verdict == "problem"
    assert "10 V, of gauge 3" in remarks["voltages"].message


def test_without_a_calibration_file_the_emulated_bench_makes_one_up():
    with emulated("ati-daq", {}, name="balance") as bench:
        bench.driver.open()
        assert bench.driver.identify().serial == "FT00001"
        bench.driver.start()
        samples = heard(bench, 0.4)
    assert len(samples) > 0
    assert np.isfinite(samples.values).all()


def test_silence_is_told_with_the_device_and_what_to_try(bench):
    bench.driver.start()
    heard(bench, 0.2)
    bench.inject("silence")
    exception = failure(bench)
    assert "device balance: no voltages for" in exception
    assert "check the card's cable" in exception
    bench.clear("silence")
    assert comes_back(bench)


def test_samples_that_were_overwritten_on_the_card_are_counted(bench):
    bench.driver.start()
    heard(bench, 0.2)
    bench.inject("overrun", 2)
    samples = heard(bench, 0.5)
    assert samples.lost == 200
    assert "200 lost" in bench.driver.health().notes[0]


def test_a_load_beyond_the_range_is_counted_as_saturated(bench):
    bench.driver.start()
    assert heard(bench, 0.2).saturated == 0
    bench.inject("saturate")
    assert heard(bench, 0.4).saturated > 0
    assert any("of its range" in note for note in bench.driver.health().notes)


def test_the_driver_undoes_what_the_sensor_makes_of_a_known_load(bench):
    bench.driver.start()
    bench.inject("saturate")
    heard(bench, 0.3)
    loads = heard(bench, 0.2).values[-1]
    matrix = np.array(json.loads(bench.driver.identify().details["matrix_si_per_v"]))
    known = 1.05 * np.array([20.0, 20.0, 60.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(loads - matrix @ emulator._OFFSET_V, known, rtol=1e-6)


def test_a_gauge_at_the_rail_is_counted_as_saturated(bench):
    bench.driver.start()
    heard(bench, 0.1)
    bench.inject("open-gauge")
    assert heard(bench, 0.4).saturated > 0


@pytest.mark.parametrize(
    ("fault", "value", "message"),
    [
        ("nonsense", True, "gauge 5 reads nan V on an input of"),
        ("restart", 1, "the card restarted its sample count"),
        ("half-frame", 1, "sends data that are not blocks of voltages"),
        ("unplug", True, "has ended the connection"),
    ],
)
def test_what_cannot_be_a_measurement_is_a_fault_and_the_device_comes_back(bench, fault, value, message):
    bench.driver.start()
    heard(bench, 0.2)
    bench.inject(fault, value)
    text = failure(bench)
    assert message in text
    assert text.startswith("device balance: ")
    assert "\n  " in text
    bench.clear(fault)
    assert comes_back(bench)


def test_late_voltages_keep_their_device_time(bench):
    bench.driver.start()
    heard(bench, 0.2)
    bench.inject("late", 0.2)
    samples = heard(bench, 0.6)
    np.testing.assert_allclose(np.diff(samples.device_time_s), 1 / 2000, rtol=1e-6)
    assert samples.lost == 0


def test_a_server_that_is_not_there_is_told_at_open(bench):
    bench.driver.close()
    bench.inject("unplug")
    with pytest.raises(DeviceError, match="device balance: the voltage server at") as raised:
        bench.driver.open()
    assert "start the program" in str(raised.value)


def test_a_missing_calibration_file_is_told_at_open(bench):
    with pytest.raises(DeviceError, match=r"calibration file /nowhere/x\.cal: No such file") as raised:
        another_driver(bench, calibration_file="/nowhere/x.cal").driver.open()
    assert "came with the sensor" in str(raised.value)


def test_without_the_vendors_driver_the_card_is_refused_with_the_next_thing_to_do(bench):
    pytest.importorskip("nidaqmx")
    other = another_driver(bench, reader="nidaqmx")
    with pytest.raises(DeviceError) as raised:
        other.driver.open()
    assert "NI-DAQmx" in str(raised.value)
    assert "ni.com/downloads" in str(raised.value) or "NI MAX" in str(raised.value)
    other.driver.close()


def test_the_reader_of_the_card_calls_what_the_library_has():
    nidaqmx = pytest.importorskip("nidaqmx")
    from nidaqmx.constants import AcquisitionType, TerminalConfiguration
    from nidaqmx.stream_readers import AnalogMultiChannelReader
    from nidaqmx.system.device import Device
    from nidaqmx.task import InStream
    from nidaqmx.task._timing import Timing

    wanted = {
        nidaqmx.Task: ("ai_channels", "devices", "in_stream", "timing", "start", "stop", "close"),
        Device: ("product_type", "serial_num"),
        InStream: ("avail_samp_per_chan",),
        Timing: ("cfg_samp_clk_timing", "samp_clk_rate"),
        AnalogMultiChannelReader: ("read_many_sample",),
        nidaqmx.errors: ("DaqNotFoundError",),
        TerminalConfiguration: ("DIFF", "RSE"),
        AcquisitionType: ("CONTINUOUS",),
    }
    assert [(o, n) for o, names in wanted.items() for n in names if not hasattr(o, n)] == []


def test_a_driver_that_is_not_open_says_so_and_closes_without_complaint():
    driver = AtiDaq("balance", AtiDaqSettings(), DeviceContext(RealClock(), np.random.default_rng(1)))
    assert not driver.health().ok
    driver.safe_stop()
    driver.close()
    with pytest.raises(DeviceError, match="is not open"):
        driver.start()


def test_a_block_is_laid_out_as_the_readme_says(card):
    settings = card.bench.table("balance").settings
    card.driver.close()
    with socket.create_connection((settings["server"], settings["server_port"]), 3.0) as plain:
        plain.sendall(b"start 2000\n")
        stream = plain.makefile("rb")
        line = stream.readline().split()
        assert line[0] == b"voltages"
        assert float(line[1]) == pytest.approx(2000.0)
        first = 0
        for _ in range(3):
            magic, count, number = struct.unpack(">4sIQ", stream.read(16))
            assert (magic, number) == (b"LRV1", first)
            assert len(stream.read(48 * count)) == 48 * count
            first += count
        plain.sendall(b"stop\n")
    card.wait_for("stop")


@given(
    st.lists(
        st.one_of(st.binary(max_size=40), st.text(max_size=20).map(lambda t: f"start {t}".encode())),
        max_size=6,
    )
)
def test_the_emulated_card_obeys_any_line_or_hangs_up(tmp_path_factory, lines):
    clock = RealClock()
    log = EmulatorLog(None, clock)
    folder = tmp_path_factory.getbasetemp()
    context = EmulatorContext(clock, np.random.default_rng(1), folder, None, Faults(), log=log)
    card = emulator.AtiDaqEmulator("balance", SimulatedAtiDaq.Settings(), context)
    for line in lines:
        card._obey(1, line)
    assert len(log.lines) == len(lines)
    assert 0 < card._rate_hz <= 1e5 * (1 + 1e-3)


def test_the_stand_in_takes_the_same_table_and_gives_the_same_channels():
    keys = {"calibration_file": "FT1.cal", "input": "Dev2/ai0:5", "rate_hz": 250}
    settings = SimulatedAtiDaq.Settings.model_validate(keys)
    assert issubclass(SimulatedAtiDaq.Settings, AtiDaqSettings)
    scene = CaudalTank(CaudalTank.Settings(), np.random.default_rng(1))
    clock = SimulatedClock()
    stand_in = SimulatedAtiDaq("balance", settings, DeviceContext(clock, np.random.default_rng(1), scene))
    driver = AtiDaq(
        "balance", AtiDaqSettings.model_validate(keys), DeviceContext(clock, np.random.default_rng(1))
    )
    stand_in.open()
    stand_in.start()
    clock.sleep(1.0)
    samples = stand_in.read()
    assert stand_in.channels == driver.channels
    assert stand_in.rate_hz == driver.rate_hz == 250
    assert 240 < len(samples) <= 250
    assert np.isfinite(samples.values).all()
