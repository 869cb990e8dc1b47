"""The FT300's driver against its emulator, in another process, and against pymodbus' own server."""

import asyncio
import os
import pty
import select
import sys
import threading
import tty

import numpy as np
import pytest
from emulated import emulated
from ft300_vectors import WRENCH_COUNTS
from labrun_plugins.robotiq_ft300.driver import RobotiqFt300
from labrun_plugins.robotiq_ft300.link import Link
from labrun_plugins.robotiq_ft300.settings import RobotiqFt300Settings

from labrun import registry
from labrun.devices import DeviceContext, Sensor, SerialPort
from labrun.errors import DeviceError
from labrun.runner import RealClock

# Other programs may keep this machine from running the emulator for a while: no test here is about the 160 ms.
PATIENT = {"port": "/dev/ttyUSB0", "silence_ms": 3000}


@pytest.fixture(scope="module")
def bench():
    with emulated("robotiq-ft300", PATIENT, name="wrench", scene="caudal-tank") as made:
        yield made


@pytest.fixture
def opened(bench):
    bench.driver.open()
    yield bench.driver
    bench.driver.close()


def other_driver(bench, **keys):
    settings = RobotiqFt300Settings(**{**PATIENT, **bench.bench.settings["wrench"], **keys})
    return RobotiqFt300("wrench", settings, DeviceContext(bench.clock, np.random.default_rng(1)))


def frames_so_far(driver):
    return int(driver.health().notes[0].split()[0])


def test_it_is_a_sensor_with_the_channels_and_the_rate_of_its_stand_in(bench):
    stand_in = registry.load("labrun.devices", "simulated-robotiq-ft300")
    context = DeviceContext(bench.clock, np.random.default_rng(1))
    for keys in ({}, {"stream": False, "poll_hz": 40}):
        simulated = stand_in("wrench", stand_in.Settings(port="p", **keys), context)
        driver = other_driver(bench, **keys)
        assert isinstance(driver, Sensor)
        assert driver.channels == simulated.channels
        assert driver.rate_hz == simulated.rate_hz


def test_it_says_what_it_is(opened):
    identity = opened.identify()
    assert identity.model == "Robotiq FT300 (FTS)"
    assert identity.firmware == "FTS-1.2.3"
    assert identity.serial == "FTS-1234"
    assert identity.details["production_year"] == "2021"
    assert identity.details["zero_offset"] == "none taken off"
    assert opened.health().notes == ("firmware FTS-1.2.3",)


def test_its_stream_is_complete_in_order_and_equals_what_the_stand_in_measures(bench, opened):
    opened.start()
    got = bench.collect(opened, 1.5)
    health = opened.health()
    opened.stop()
    assert len(got["host_s"]) > 110
    assert got["lost"] == 0
    assert got["saturated"] == 0
    assert np.all(np.diff(got["host_s"]) >= 0)
    np.testing.assert_array_equal(got["host_s"], got["device_s"])
    counts = got["values"] / [0.01, 0.01, 0.01, 0.001, 0.001, 0.001]
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert health.ok
    assert "0 wrong checksums" in health.notes[0]

    # The same generator gives the stand-in the same offsets: a dry run and an emulated one measure the same.
    rng = np.random.default_rng(np.random.SeedSequence([1, 0xE31, 0]))
    scene = registry.load("labrun.scenes", "caudal-tank")({}, np.random.default_rng(2))
    made = registry.load("labrun.devices", "simulated-robotiq-ft300")
    stand_in = made("wrench", made.Settings(**PATIENT), DeviceContext(bench.clock, rng, scene))
    values, _ = stand_in.measure(bench.clock.now() + 0.01 * np.arange(400))
    np.testing.assert_allclose(got["values"].mean(axis=0), values.mean(axis=0), atol=0.06)
    np.testing.assert_allclose(got["values"].std(axis=0), values.std(axis=0), rtol=0.35)


def test_nothing_that_came_before_the_start_is_handed_over(bench, opened):
    opened.start()
    bench.wait_until(lambda: len(opened.read()))
    bench.clock.sleep(0.2)
    opened.stop()
    started_s = bench.clock.now()
    opened.start()
    bench.wait_until(lambda: frames_so_far(opened) > 0)
    assert opened.read().host_time_s[0] > started_s
    opened.stop()


def test_read_says_what_comes_first(bench, opened):
    with pytest.raises(DeviceError, match=r"is not streaming[\s\S]*start\(\) comes before"):
        opened.read()
    opened.close()
    with pytest.raises(DeviceError, match="is not open"):
        opened.start()
    assert not opened.health().ok


def test_safe_stop_from_any_thread_ends_the_stream_and_it_starts_again(bench, opened):
    opened.safe_stop()
    opened.start()
    bench.wait_until(lambda: len(opened.read()))
    asked_s = bench.clock.now()
    threads = [threading.Thread(target=opened.safe_stop) for _ in range(3)]
    for thread in threads:
        thread.start()
    stopped = bench.wait_for("stop", after_s=asked_s)
    # 26 ms are 50 bytes on the line; the rest is for a machine with other things to do
    assert stopped["time_s"] - asked_s < 1.0
    for thread in threads:
        thread.join()
    opened.read()
    bench.clock.sleep(0.3)
    assert len(opened.read()) == 0
    assert opened.health().ok
    opened.stop()
    opened.start()
    bench.wait_until(lambda: len(opened.read()))
    opened.stop()


def test_without_the_stream_it_reads_its_registers(bench):
    driver = other_driver(bench, stream=False, poll_hz=40)
    driver.open()
    try:
        assert driver.identify().details["mode"] == "registers, 40 Hz"
        driver.start()
        got = bench.collect(driver, 1.0)
        assert 20 <= len(got["host_s"]) + got["lost"] <= 45
        assert got["values"][:, 2].mean() == pytest.approx(-4.3, abs=3.0)
        assert "readings" in driver.health().notes[0]
        driver.stop()
        assert driver.health().notes == ("firmware FTS-1.2.3",)
        remarks = {remark.subject: remark for remark in driver.examine()}
        assert "stream = true gives 100 Hz" in remarks["rate"].message or remarks["rate"].verdict == "warning"
    finally:
        driver.close()


def test_probe_finds_it_even_while_it_streams_and_leaves_the_port_free(bench):
    port = bench.bench.settings["wrench"]["port"]
    for streaming in ("no", "yes"):
        if streaming == "yes":
            bench.inject("streaming", 1)
            bench.wait_for("stream")
        # A busy machine may let the short time-outs of a probe pass; a person would ask again, too.
        probe = next(filter(None, (RobotiqFt300.probe(port) for _ in range(5))), None)
        assert probe is not None
        assert probe.serial == "FTS-1234"
        assert probe.details["was_still_streaming"] == streaming
    bench.driver.open()
    bench.driver.close()


def test_probe_finds_nothing_where_nobody_answers_or_something_else_talks():
    master, slave = pty.openpty()
    for end in (master, slave):
        tty.setraw(end)
    port = os.ttyname(slave)
    assert RobotiqFt300.probe(port) is None
    assert os.read(master, 100) == bytes.fromhex("09 03 01 F4 00 03 44 8D")
    ended = threading.Event()

    def talk():
        while not ended.wait(0.005):
            os.write(master, b"$GPGGA,120000\r\n")

    talker = threading.Thread(target=talk)
    talker.start()
    try:
        assert RobotiqFt300.probe(port) is None
    finally:
        ended.set()
        talker.join()
    os.set_blocking(master, False)
    with pytest.raises(BlockingIOError):
        os.read(master, 100)  # to something that talks by itself, nothing was sent
    os.close(master)
    os.close(slave)
    assert RobotiqFt300.probe(port) is None


def test_examine_judges_the_stream(bench, opened):
    remarks = {remark.subject: remark for remark in opened.examine()}
    assert remarks["identity"].message == "firmware FTS-1.2.3, serial FTS-1234, made in 2021"
    assert remarks["checksums"].verdict == "ok"
    assert remarks["rate"].message.startswith("stream of ")
    assert "left streaming" not in remarks
    bench.inject("rate", 62.5)
    opened.start()
    bench.inject("corrupt", 5)
    bench.wait_until(lambda: frames_so_far(opened) > 40)
    remarks = {remark.subject: remark for remark in opened.examine()}
    opened.stop()
    bench.clear("rate")
    assert remarks["rate"].verdict == "problem"
    assert "62.5 Hz means a latency timer of 16 ms: echo 1 | sudo tee" in remarks["rate"].advice
    assert remarks["checksums"].verdict == "warning"


def test_without_pymodbus_it_says_what_to_install(bench, monkeypatch):
    for module in [name for name in sys.modules if name.split(".")[0] == "pymodbus"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "pymodbus", None)
    with pytest.raises(DeviceError, match=r"needs pymodbus[\s\S]*pip install 'labrun\[robotiq\]'"):
        bench.driver.open()


# --- against pymodbus' own server: a second opinion on the register half ----------------------------------------------


class Pump:
    """Carries bytes between the masters of two ptys, whose slaves a server and a driver open by name."""

    def __enter__(self):
        self.ends = [pty.openpty() for _ in range(2)]
        for pair in self.ends:
            for end in pair:
                tty.setraw(end)
        self.server_port, self.driver_port = (os.ttyname(slave) for _, slave in self.ends)
        self.ended = False
        self.thread = threading.Thread(target=self._carry)
        self.thread.start()
        return self

    def _carry(self):
        (first, _), (other, _) = self.ends
        while not self.ended:
            for ready in select.select([first, other], [], [], 0.05)[0]:
                os.write(other if ready == first else first, os.read(ready, 1000))

    def __exit__(self, *_):
        self.ended = True
        self.thread.join()
        for pair in self.ends:
            for end in pair:
                os.close(end)


@pytest.fixture
def pymodbus_port():
    from pymodbus.framer import FramerType
    from pymodbus.server import ModbusSerialServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    blocks = {
        180: [count & 0xFFFF for count in WRENCH_COUNTS],
        410: [0],
        500: [0x4654, 0x5301, 0x0203],
        510: [0x4654, 0x5300, 1234, 0, 2021],
    }
    device = SimDevice(
        9,
        simdata=[
            SimData(address, values=values, datatype=DataType.REGISTERS) for address, values in blocks.items()
        ],
    )
    with Pump() as pump:
        loop = asyncio.new_event_loop()

        async def serve():
            server = ModbusSerialServer(device, framer=FramerType.RTU, port=pump.server_port, baudrate=19_200)
            await server.serve_forever(background=True)
            return server

        server = loop.run_until_complete(serve())
        thread = threading.Thread(target=loop.run_forever)
        thread.start()
        yield pump.driver_port
        asyncio.run_coroutine_threadsafe(server.shutdown(), loop).result(5.0)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


def test_pymodbus_own_server_agrees_with_the_register_half(pymodbus_port):
    clock = RealClock()
    port = SerialPort("wrench", pymodbus_port, 19_200)
    port.open()
    try:
        link = Link("wrench", port, clock, 9, answer_s=1.0)
        plate = link.nameplate()
        assert (plate.firmware, plate.serial, plate.year) == ("FTS-1.2.3", "FTS-1234", 2021)
        assert link.registers.read(180, 6) == tuple(count & 0xFFFF for count in WRENCH_COUNTS)
        link.start_stream()
        assert link.registers.read(410, 1) == (0x0200,)
        with pytest.raises(DeviceError, match="exception 02, it has no such register"):
            link.registers.read(600, 1)
    finally:
        port.close()


def test_the_driver_measures_pymodbus_own_server_register_by_register(pymodbus_port):
    clock = RealClock()
    settings = RobotiqFt300Settings(port=pymodbus_port, stream=False, poll_hz=20)
    driver = RobotiqFt300("wrench", settings, DeviceContext(clock, np.random.default_rng(1)))
    driver.open()
    try:
        driver.start()
        until_s = clock.now() + 5.0
        while not len(block := driver.read()) and clock.now() < until_s:
            clock.sleep(0.02)
        np.testing.assert_allclose(block.values[0], [12.34, -56.78, 100.0, 1.234, -0.567, 2.0], atol=1e-12)
    finally:
        driver.close()


def test_pymodbus_own_client_agrees_with_the_emulator_and_waits_in_vain_while_it_streams(bench):
    from pymodbus.client import ModbusSerialClient
    from pymodbus.exceptions import ModbusIOException

    port = bench.bench.settings["wrench"]["port"]
    client = ModbusSerialClient(port, baudrate=19_200, timeout=0.3, retries=3)
    assert client.connect()
    try:
        assert client.read_holding_registers(500, count=3, device_id=9).registers == [0x4654, 0x5301, 0x0203]
        assert client.read_holding_registers(190, count=3, device_id=9).registers == [0, 0, 1000]
        assert client.read_holding_registers(600, count=1, device_id=9).exception_code == 2
        assert not client.write_register(410, 0x0200, device_id=9).isError()  # the short form, function 06
        bench.wait_until(lambda: client.socket.in_waiting > 32)
        with pytest.raises(ModbusIOException):
            client.read_holding_registers(500, count=3, device_id=9)
        client.socket.write(b"\xff" * 50)
        bench.wait_for("stop", after_s=bench.events("stream")[-1]["time_s"])
        bench.clock.sleep(0.2)
        client.socket.reset_input_buffer()
        assert client.read_holding_registers(514, count=1, device_id=9).registers == [2021]
    finally:
        client.close()
