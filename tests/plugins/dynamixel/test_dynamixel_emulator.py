"""The emulated servo keeps the rules of the manual."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.dynamixel import emulated_packets as wire
from labrun_plugins.dynamixel.codec import StatusParser
from labrun_plugins.dynamixel.emulated_servo import EmulatedServo, EmulatedShaft, Table
from labrun_plugins.dynamixel.emulator import DynamixelEmulator, EmulatedBus
from labrun_plugins.simulated.dynamixel import SimulatedDynamixelSettings

from labrun.devices.emulation import EmulatorContext, EmulatorLog, Faults
from labrun.errors import DeviceError

EEPROM, RAM = [(9, 1), (11, 1), (48, 4), (8, 1)], [(112, 4), (84, 2), (98, 1)]


class Clock:
    poll_s = 0.01

    def __init__(self):
        self.time_s = 100.0

    def now(self):
        return self.time_s

    def sleep(self, duration_s):
        self.time_s += duration_s


class Line:
    """A bus of emulated servos that is spoken to directly."""

    def __init__(self, ids=(1, 2, 3), model=1030, firmware=46):
        self.clock = Clock()
        self.log = EmulatorLog(None, self.clock)
        now = self.clock.now()
        self.servos = [
            EmulatedServo(
                f"j{i}", i, Table(model, firmware), EmulatedShaft(f"j{i}", 0.0, None, now), self.log, now
            )
            for i in ids
        ]
        self.silent: set[int] = set()
        self.bus = EmulatedBus(self.servos, lambda servo: servo.id in self.silent, lambda: False, self.log)

    def say(self, identity, code, parameters=b""):
        """Say something; return (id, error, data) of each answer, and remember when they leave."""
        (instruction,) = wire.InstructionReader().feed(wire.instruction_packet(identity, code, parameters))
        answers = self.bus.handle(instruction, self.clock.now())
        self.delays_s = [answer.leaves_s - self.clock.now() for answer in answers]
        parser = StatusParser()
        return [(s.id, s.error, s.data) for answer in answers for s in parser.feed(answer.packet)]

    def read(self, identity, address, length=4):
        return self.say(identity, wire.READ, _u16(address) + _u16(length))

    def value(self, identity, address, length=4, *, signed=False):
        ((_, error, data),) = self.read(identity, address, length)
        assert error & 0x7F == 0
        return int.from_bytes(data, "little", signed=signed)

    def write(self, identity, address, value, length=4):
        return self.say(
            identity, wire.WRITE, _u16(address) + (value % 256**length).to_bytes(length, "little")
        )

    def wait(self, duration_s):
        """Pass time in small steps, as the emulator does."""
        for _ in range(round(duration_s / 0.01)):
            self.clock.sleep(0.01)
            for servo in self.servos:
                servo.watch(self.clock.now())

    def move(self, identity, goal):
        self.write(identity, 64, 1, 1)
        return self.write(identity, 116, goal)


def _u16(value):
    return value.to_bytes(2, "little")


def test_a_ping_gives_model_and_firmware_and_a_broadcast_ping_everybodys_in_turn():
    line = Line()
    assert line.say(1, wire.PING) == [(1, 0, _u16(1030) + b"\x2e")]
    assert [answer[0] for answer in line.say(254, wire.PING)] == [1, 2, 3]
    assert line.delays_s == pytest.approx([500e-6, 1000e-6, 1500e-6])


def test_an_answer_waits_for_the_return_delay():
    line = Line()
    line.read(1, 132)
    assert line.delays_s == [pytest.approx(500e-6)]
    line.write(1, 9, 0, 1)
    line.read(1, 132)
    assert line.delays_s == [0.0]


@pytest.mark.parametrize(("address", "length"), EEPROM)
def test_eeprom_is_locked_while_the_torque_is_on(address, length):
    line = Line()
    before = line.value(1, address, length)
    new = 4 if address == 11 else 3
    line.write(1, 64, 1, 1)
    assert line.write(1, address, new, length) == [(1, 7, b"")]
    assert line.value(1, address, length) == before
    line.write(1, 64, 0, 1)
    assert line.write(1, address, new, length) == [(1, 0, b"")]
    assert line.value(1, address, length) == new


@pytest.mark.parametrize(("address", "length"), RAM)
def test_ram_is_not_locked(address, length):
    line = Line()
    line.write(1, 64, 1, 1)
    assert line.write(1, address, 5, length) == [(1, 0, b"")]
    assert line.value(1, address, length) == 5


def test_what_is_read_only_or_not_there_gives_no_access_and_no_data():
    line = Line()
    assert line.write(1, 132, 0) == [(1, 7, b"")]
    assert line.read(1, 14, 1) == [(1, 7, b"")]
    assert line.read(1, 64, 8) == [(1, 7, b"")]  # 66 and 67 belong to nothing
    assert line.write(1, 116, 5, 2) == [(1, 5, b"")]  # half a line
    assert line.write(1, 11, 7, 1) == [(1, 4, b"")]  # there is no mode 7
    assert line.say(1, 0x77) == [(1, 2, b"")]


def test_a_goal_beyond_the_limits_is_refused_and_changes_nothing():
    line = Line()
    line.write(1, 48, 3000)
    line.write(1, 52, 1000)
    line.move(1, 2500)
    assert line.write(1, 116, 3001) == [(1, 6, b"")]
    assert line.write(1, 116, 999) == [(1, 6, b"")]
    assert line.value(1, 116) == 2500


def test_extended_mode_takes_goals_of_many_turns():
    line = Line()
    line.write(1, 11, 4, 1)
    assert line.move(1, -10_000) == [(1, 0, b"")]
    line.wait(20.0)
    assert line.value(1, 132, signed=True) == pytest.approx(-10_000, abs=2)
    assert line.write(1, 116, 1_048_576) == [(1, 6, b"")]


def test_whole_turns_are_forgotten_on_request_by_a_shaft_at_rest_and_on_a_restart():
    line = Line()
    clear = bytes([1, 0x44, 0x58, 0x4C, 0x22])
    line.write(1, 11, 4, 1)
    line.move(1, 10_000)
    assert line.say(1, wire.CLEAR, b"no") == [(1, 5, b"")]
    line.wait(0.1)
    assert line.say(1, wire.CLEAR, clear) == [(1, 1, b"")]
    line.wait(10.0)
    line.write(1, 64, 0, 1)
    assert line.say(1, wire.CLEAR, clear) == [(1, 0, b"")]
    assert line.value(1, 132, signed=True) == pytest.approx(10_000 % 4096, abs=1)
    line.move(1, 0)
    line.wait(10.0)
    assert line.value(1, 132, signed=True) == pytest.approx(0, abs=1)
    line.move(1, -3000)
    line.wait(5.0)
    line.say(1, wire.REBOOT)
    line.wait(0.5)
    assert line.value(1, 132, signed=True) == pytest.approx(1096, abs=1)


def test_a_new_mode_resets_gains_profile_and_goals():
    line = Line()
    for address, length in ((84, 2), (112, 4), (108, 4)):
        line.write(1, address, 77, length)
    line.write(1, 11, 1, 1)
    assert [line.value(1, a, n) for a, n in ((84, 2), (112, 4), (108, 4))] == [800, 0, 0]
    assert line.value(1, 102, 2) == 1193


def test_a_shaft_reaches_its_goal_and_says_so():
    line = Line()
    line.move(1, 3000)
    line.wait(0.03)
    assert line.value(1, 128, signed=True) > 100
    assert line.value(1, 122, 1) == 1
    line.wait(1.5)
    assert line.value(1, 132) == pytest.approx(3000, abs=1)
    assert line.value(1, 128, signed=True) == 0


def test_a_profile_velocity_slows_the_shaft():
    line = Line()
    line.write(1, 112, 50)
    line.move(1, 3000)
    line.wait(0.3)
    assert line.value(1, 128, signed=True) == 50


def test_velocity_mode_turns_at_the_goal_velocity():
    line = Line()
    line.write(1, 11, 1, 1)
    line.write(1, 64, 1, 1)
    assert line.write(1, 104, -100) == [(1, 0, b"")]
    line.wait(1.0)
    assert line.value(1, 132, signed=True) == pytest.approx(2048 - 100 * 0.229 / 60 * 4096, abs=2)
    assert line.write(1, 104, 331) == [(1, 6, b"")]


def test_the_watchdog_stops_a_servo_that_hears_nothing_and_locks_its_goals():
    line = Line()
    line.move(1, 4000)
    line.write(1, 98, 5, 1)
    line.wait(0.09)
    assert not [x for x in line.log.lines if x["event"] == "watchdog"]
    line.say(3, wire.PING)  # any instruction on the bus counts, for whomever
    line.wait(0.09)
    assert not [x for x in line.log.lines if x["event"] == "watchdog"]
    line.wait(0.02)
    assert [x["joint"] for x in line.log.lines if x["event"] == "watchdog"] == ["j1"]
    here = line.value(1, 132)
    assert line.value(1, 98, 1) == 0xFF
    assert line.write(1, 116, 2000) == [(1, 4, b"")]
    line.wait(0.3)
    assert line.value(1, 132) == here
    line.write(1, 98, 0, 1)
    assert line.write(1, 116, 2000) == [(1, 0, b"")]


def test_the_watchdog_minds_only_servos_with_torque():
    line = Line()
    line.write(1, 98, 1, 1)
    line.wait(0.2)
    assert line.value(1, 98, 1) == 1


def test_overheating_takes_the_torque_and_shows_in_every_answer_until_a_restart():
    line = Line()
    line.move(1, 3000)
    line.servos[0].warm(85.0, line.clock.now())
    assert line.read(1, 70, 1) == [(1, 0x80, b"\x04")]
    assert line.value(1, 64, 1) == 0
    assert line.write(1, 98, 0, 1) == [(1, 0x80, b"")]
    line.servos[0].warm(35.0, line.clock.now())
    assert line.read(1, 70, 1)[0][1] == 0x80
    assert line.say(1, wire.REBOOT) == [(1, 0, b"")]
    assert line.say(1, wire.PING) == []  # it starts
    line.wait(0.5)
    assert line.read(1, 70, 1) == [(1, 0, b"\x00")]


def test_an_error_that_is_not_enabled_leaves_the_torque_on():
    line = Line()
    line.write(1, 63, 0, 1)
    line.move(1, 2100)
    line.servos[0].suffer(1 << 5, line.clock.now())
    assert line.read(1, 64, 1) == [(1, 0x80, b"\x01")]


def test_a_restart_keeps_eeprom_and_forgets_ram():
    line = Line()
    line.write(1, 9, 10, 1)
    line.write(1, 84, 500, 2)
    line.say(1, wire.REBOOT)
    line.wait(0.5)
    assert line.value(1, 9, 1) == 10
    assert line.value(1, 84, 2) == 800


@pytest.mark.parametrize(
    ("level", "answered"), [(0, (True, False, False)), (1, (True, True, False)), (2, (True, True, True))]
)
def test_the_status_return_level_decides_what_is_answered(level, answered):
    line = Line()
    line.write(1, 68, level, 1)
    messages = (line.say(1, wire.PING), line.read(1, 132), line.write(1, 112, 0))
    assert [bool(answers) for answers in messages] == [True, level >= 1, level >= 2]


def test_broadcast_and_group_writes_are_obeyed_without_an_answer():
    line = Line()
    assert line.say(254, wire.WRITE, _u16(112) + (7).to_bytes(4, "little")) == []
    assert line.say(254, wire.SYNC_WRITE, _u16(84) + _u16(2) + b"\x01" + _u16(10) + b"\x03" + _u16(30)) == []
    bulk = b"\x01" + _u16(112) + _u16(4) + (9).to_bytes(4, "little") + b"\x02" + _u16(84) + _u16(2) + _u16(20)
    assert line.say(254, wire.BULK_WRITE, bulk) == []
    assert [line.value(i, 112) for i in (1, 2, 3)] == [9, 7, 7]
    assert [line.value(i, 84, 2) for i in (1, 2, 3)] == [10, 20, 30]


def test_group_reads_are_answered_in_the_order_of_their_list():
    line = Line()
    ordinary = line.say(254, wire.SYNC_READ, _u16(132) + _u16(4) + bytes([3, 1, 2]))
    assert [(i, e, len(d)) for i, e, d in ordinary] == [(3, 0, 4), (1, 0, 4), (2, 0, 4)]
    assert line.delays_s == pytest.approx([500e-6, 1000e-6, 1500e-6])
    bulk = line.say(254, wire.BULK_READ, b"\x02" + _u16(146) + _u16(1) + b"\x01" + _u16(144) + _u16(2))
    assert [(i, d) for i, _, d in bulk] == [(2, b"\x23"), (1, _u16(120))]


def test_fast_reads_are_answered_in_one_packet_after_one_return_delay():
    line = Line()
    ((identity, _, data),) = line.say(254, wire.FAST_SYNC_READ, _u16(132) + _u16(4) + bytes([3, 1]))
    assert identity == 254
    assert data[0] == 3
    assert line.delays_s == pytest.approx([500e-6])
    ((identity, _, _),) = line.say(
        254, wire.FAST_BULK_READ, b"\x02" + _u16(146) + _u16(1) + b"\x01" + _u16(144) + _u16(2)
    )
    assert identity == 254


def test_old_firmware_knows_neither_fast_reads_nor_the_watchdog():
    line = Line(firmware=37)
    assert line.say(254, wire.FAST_SYNC_READ, _u16(132) + _u16(4) + bytes([3, 1])) == []
    assert line.write(1, 98, 5, 1) == [(1, 7, b"")]


def test_those_after_a_silent_servo_wait_for_it_in_vain():
    line = Line()
    line.silent = {1}
    assert [i for i, _, _ in line.say(254, wire.SYNC_READ, _u16(132) + _u16(4) + bytes([3, 1, 2]))] == [3]
    assert line.say(254, wire.FAST_SYNC_READ, _u16(132) + _u16(4) + bytes([3, 1, 2])) == []


def test_a_registered_write_waits_for_the_action():
    line = Line()
    assert line.say(1, wire.REG_WRITE, _u16(112) + (7).to_bytes(4, "little")) == [(1, 0, b"")]
    assert (line.value(1, 112), line.value(1, 69, 1)) == (0, 1)
    assert line.say(254, wire.ACTION) == []
    assert (line.value(1, 112), line.value(1, 69, 1)) == (7, 0)


def test_indirect_addresses_gather_scattered_registers():
    line = Line()
    for slot, target in enumerate((70, 144, 145, 146)):
        assert line.write(1, 168 + 2 * slot, target, 2) == [(1, 0, b"")]
    assert line.read(1, 224, 4) == [(1, 0, b"\x00\x78\x00\x23")]
    for n in range(4):
        line.write(1, 578 + 2 * n, 112 + n, 2)
    assert line.write(1, 634, 99) == [(1, 0, b"")]
    assert line.value(1, 112) == 99
    assert line.write(1, 168, 10, 2) == [(1, 4, b"")]  # EEPROM cannot be pointed at


def test_a_shadow_id_obeys_and_is_silent():
    line = Line()
    line.write(2, 12, 9, 1)
    assert line.write(9, 112, 42) == []
    assert line.value(2, 112) == 42


def test_an_instruction_with_a_wrong_check_sum_is_refused_and_not_obeyed():
    line = Line()
    packet = bytearray(wire.instruction_packet(1, wire.WRITE, _u16(112) + (7).to_bytes(4, "little")))
    packet[-3] ^= 1
    (instruction,) = wire.InstructionReader().feed(bytes(packet))
    (answer,) = line.bus.handle(instruction, line.clock.now())
    assert answer.packet == wire.status_packet(1, 3)
    assert line.value(1, 112) == 0


def test_models_without_a_current_sensor_have_no_goal_current():
    line = Line(model=1060)
    assert line.write(1, 102, 0, 2) == [(1, 7, b"")]
    assert line.say(1, wire.PING)[0][2][:2] == _u16(1060)


@given(
    st.lists(st.tuples(st.sampled_from([1, 2, 254]), st.integers(0, 255), st.binary(max_size=30)), max_size=8)
)
@settings(max_examples=60, deadline=None)
def test_no_instruction_breaks_a_servo(message):
    line = Line(ids=(1, 2))
    for identity, code, parameters in message:
        line.say(identity, code, parameters)
        line.wait(0.02)
    assert [servo.table.get(0) for servo in line.servos] == [1030, 1030]


def test_a_shaft_told_in_small_steps_moves_as_the_stand_ins_does():
    """Goals 10 ms apart through the emulated shaft, against the stand-in's motion for the same held commands."""
    import numpy as np
    from labrun_plugins.simulated.dynamixel import SHAFT

    from labrun.devices import Trajectory

    time_s = np.arange(0.0, 1.0, 0.01)
    goals = np.round(np.radians(40) * np.sin(2 * np.pi * 1.4 * time_s) / SHAFT.step_rad) * SHAFT.step_rad
    shaft = EmulatedShaft("tail", 0.0, None, 5.0)
    results = []
    for at_s, goal in zip(time_s, goals, strict=True):
        shaft.go(float(goal), SHAFT.speed_rad_s, 5.0 + at_s)
        results.append(shaft.state(5.0 + at_s)[0])
    held = np.repeat(np.column_stack([time_s, time_s + 0.01 - 1e-9]).ravel(), 1)
    stairs = Trajectory(("tail",), held, np.repeat(goals, 2)[:, None])
    wanted = SHAFT.motion("tail", stairs, 0.0).at(time_s)[:, 0]
    assert np.abs(np.array(results) - wanted).max() < np.radians(0.1)


def test_a_joint_that_the_bench_lacks_is_told_before_anything_moves(tmp_path):
    bench = SimpleNamespace(joints=("shoulder", "elbow"))
    log = EmulatorLog(None, Clock())
    context = EmulatorContext(Clock(), np.random.default_rng(1), tmp_path, bench, Faults(), log=log)
    limits = {"angle_deg": [-90, 90], "speed_deg_s": 90}
    keys = {"port": "/dev/none", "baud": 57600, "joints": {"sholder": {"id": 1}}, "limits": limits}
    settings = SimulatedDynamixelSettings.model_validate(keys)
    with pytest.raises(DeviceError, match="no joint sholder") as raises:
        DynamixelEmulator("servos", settings, context).open()
    assert "it has shoulder, elbow" in str(raises.value)
