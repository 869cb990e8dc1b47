import numpy as np
import pytest
from labrun_plugins.ur5.connection import Connection
from ur5_bench import another, arrived, as_new, begin, error_of, moving, served, since, works_again

from labrun.devices import DeviceError


@pytest.fixture(scope="module")
def cb3():
    with served() as bench:
        yield bench


@pytest.fixture(scope="module")
def e_series():
    with served(**{"e-series": True}) as bench:
        yield bench


@pytest.fixture
def bench(cb3):
    with as_new(cb3) as prepared:
        yield prepared


@pytest.fixture
def e_bench(e_series):
    with as_new(e_series) as prepared:
        yield prepared


def test_a_controller_that_is_not_there_is_named_with_its_address(bench):
    with pytest.raises(DeviceError, match=r"cannot reach its dashboard server at 127\.0\.0\.1:1: .*refused"):
        another(bench, dashboard_port=1).open()
    with pytest.raises(DeviceError, match="cannot reach its dashboard server"):
        another(bench, interface="203.0.113.7").open()


def test_a_silent_controller_is_found_and_comes_back(bench):
    arm = moving(bench)
    bench.inject("silence")
    for look in (arm.health, arm.read, arm.position_m):
        words = error_of(bench, look)
        assert "has sent nothing for" in words
        assert "network cable" in words
    asked_s = bench.clock.now()
    arm.safe_stop()
    bench.wait_for("stop", after_s=asked_s)
    bench.clear("silence")
    assert works_again(bench)


def test_a_controller_that_is_silent_from_the_start_is_told_so(bench):
    bench.inject("silence")
    with pytest.raises(DeviceError, match="dashboard server does not answer"):
        bench.driver.open()
    bench.clear("silence")
    assert works_again(bench)


def test_a_late_answer_is_never_taken_for_that_to_the_next_question(bench):
    arm = bench.driver
    arm.open()
    bench.inject("late", 1.4)
    assert "does not answer" in error_of(bench, arm._link.dashboard.remote_control)
    bench.clear("late")
    bench.clock.sleep(0.5)
    assert arm._link.dashboard.ask("get serial number").isdigit()
    assert arm._link.dashboard.ask("get robot model") == "UR5"


def test_flipped_bits_end_in_an_error_or_nothing_and_never_in_a_hang(bench):
    for _ in range(4):
        arm = bench.driver
        arm.open()
        arm.start()
        bench.inject("corrupt", 10)
        bench.wait_until(lambda link=arm._link: not link._listener.running or link.tracking.received > 40)
        try:
            samples = arm.read()
        except DeviceError as error:
            assert str(error).startswith("device arm: ")
        else:
            assert len(samples.host_time_s) == len(samples.values)
        bench.clear("corrupt")
        arm.close()
    assert works_again(bench)


def test_late_packages_keep_the_controllers_time(bench):
    bench.inject("late", 0.15)
    arm = bench.driver
    arm.open()
    arm.start()
    bench.clock.sleep(0.5)
    samples = arm.read()
    steps = np.diff(samples.device_time_s)
    assert np.median(steps) == pytest.approx(0.008, rel=1e-3)
    assert samples.lost == np.sum(np.round(steps / 0.008) - 1)


@pytest.mark.parametrize("faults", [{"fragment": True}, {"coalesce": 3}])
def test_packages_in_pieces_or_together_are_the_same_packages(e_bench, faults):
    # Broken into single bytes, half a millisecond apart, a package takes an eighth of a second.
    e_bench.driver = arm = another(e_bench, rate_hz=6.25)
    arm.open()
    arm.start()
    for fault, value in faults.items():
        e_bench.inject(fault, value)
    e_bench.wait_until(lambda: arm._link.tracking.received > 8, 8.0)
    samples = arm.read()
    steps = np.diff(samples.device_time_s)
    assert np.all(np.abs(steps - 0.16 * np.round(steps / 0.16)) < 1e-4)
    assert np.ptp(samples.values) < 1e-3


def test_skipped_packages_are_counted_by_the_time_stamps(bench):
    arm = bench.driver
    arm.open()
    arm.start()
    bench.clock.sleep(0.1)
    bench.inject("skip", 7)
    bench.clock.sleep(0.3)
    samples = arm.read()
    assert samples.lost >= 7
    assert samples.lost == np.sum(np.round(np.diff(samples.device_time_s) / 0.008) - 1)
    assert any("packages lost" in note for note in arm.health().notes)


@pytest.mark.parametrize("fault", ["duplicate", "reorder"])
def test_a_package_that_comes_twice_or_late_is_dropped(bench, fault):
    arm = bench.driver
    arm.open()
    arm.start()
    bench.inject(fault, 5)
    bench.wait_until(lambda: arm._link.tracking.stale > 0)
    bench.clock.sleep(0.1)
    assert np.all(np.diff(arm.read().device_time_s) > 0)


@pytest.mark.parametrize(
    ("fault", "words"), [("bad-size", "sent a package of 1 bytes"), ("truncate", "service sent")]
)
def test_a_broken_package_ends_the_stream_and_a_new_connection_mends_it(bench, fault, words):
    arm = moving(bench)
    bench.inject(fault, 1)
    assert words in error_of(bench, arm.read)
    asked_s = bench.clock.now()
    arm.safe_stop()
    bench.wait_for("stop", after_s=asked_s)
    assert works_again(bench)


def test_a_connection_that_is_reset_is_named_and_can_be_made_again(bench):
    arm = moving(bench)
    reset_s = bench.clock.now()
    bench.inject("reset", 1)
    words = error_of(bench, arm.read)
    assert "lost its RTDE service" in words
    assert "labrun resume" in words
    bench.wait_for("watchdog", after_s=reset_s)  # nobody refreshes the register any more
    bench.wait_for("still", after_s=reset_s)
    arm.safe_stop()
    assert works_again(bench)


def test_a_controller_that_was_restarted_is_told_by_its_clock(bench):
    arm = bench.driver
    arm.open()
    arm.start()
    bench.inject("restart", 1)
    assert "controller was restarted" in error_of(bench, arm.read)
    assert works_again(bench)


def test_a_controller_without_protocol_2_is_spoken_to_in_protocol_1(bench):
    bench.inject("no-v2")
    arm = bench.driver
    arm.open()
    assert arm.identify().details["rtde_protocol"] == "1"
    assert works_again(bench)
    assert "speaks version 1 only" in [remark.message for remark in arm.examine()]


def test_a_variable_the_controller_lacks_is_left_out(bench):
    bench.inject("not-found", "actual_TCP_force,safety_status_bits")
    assert works_again(bench)
    assert bench.driver._link.rtde.missing == ("safety_status_bits", "actual_TCP_force")
    bench.inject("safeguard-stop")  # the safety mode alone tells, too
    assert "safeguard stop" in error_of(bench, bench.driver.read)


def test_a_variable_the_driver_needs_is_named(bench):
    bench.inject("not-found", "speed_scaling")
    with pytest.raises(DeviceError, match="does not know speed_scaling") as error:
        bench.driver.open()
    assert "update PolyScope" in str(error.value)


def test_another_owner_of_the_register_is_told_and_a_second_labrun_is_one(bench):
    bench.inject("in-use")
    with pytest.raises(DeviceError, match="another program owns input_int_register_24") as error:
        bench.driver.open()
    assert "watchdog_register" in str(error.value)
    bench.clear("in-use")
    assert works_again(bench)
    with pytest.raises(DeviceError, match="another program owns"):
        another(bench).open()
    other = another(bench, watchdog_register=25)
    other.open()
    other.close()


def test_a_protective_stop_ends_the_move_and_only_a_person_unlocks_it(bench):
    begun_s = bench.clock.now()
    arm = moving(bench)
    bench.inject("protective-stop")
    words = error_of(bench, arm.read)
    assert "protective stop" in words
    assert "labrun never unlocks it" in words
    for look in (arm.position_m, arm.health, lambda: arm.travel(0.1, 0.05)):
        assert "protective stop" in error_of(bench, look)
    stopped_s = bench.wait_for("protective stop", after_s=begun_s)["time_s"]
    bench.wait_for("still", after_s=begun_s)
    bench.clear("protective-stop")
    arm.safe_stop()
    arm.close()
    arm.open()
    assert "protective stop" in error_of(bench, arm.position_m)
    person = arm._link.dashboard
    assert "Cannot unlock" in person.ask("unlock protective stop")
    bench.clock.sleep(stopped_s + 5.1 - bench.clock.now())
    assert bench.events("unlocked") == []
    assert person.ask("unlock protective stop") == "Protective stop releasing"
    assert person.ask("close safety popup") == "closing safety popup"
    bench.wait_until(lambda: arm._link.tracking.state.safety_mode == 1)
    assert len(since(bench, "command", begun_s)) == 1  # the refused move was never sent
    assert works_again(bench)


@pytest.mark.parametrize(
    ("fault", "words", "next_thing"),
    [
        ("emergency-stop", "emergency stop", "turn the red button"),
        ("safeguard-stop", "safeguard stop", "close the guard"),
        ("power-off", "'power off'", "release the brakes"),
    ],
)
def test_every_other_stop_is_named_with_the_way_out(bench, fault, words, next_thing):
    begun_s = bench.clock.now()
    arm = moving(bench)
    bench.inject(fault)
    error = error_of(bench, arm.read)
    assert words in error
    assert next_thing in error
    bench.wait_for("still", after_s=begun_s)
    bench.clear(fault)
    arm.safe_stop()
    bench.wait_until(
        lambda: arm._link.tracking.state.safety_mode == 1 and arm._link.tracking.state.robot_mode == 7
    )
    assert works_again(bench)


def test_an_arm_that_is_off_when_it_is_opened_takes_its_line_once_it_runs(bench):
    bench.inject("power-off")
    bench.driver = arm = another(bench, origin_m=None)
    arm.open()
    assert arm.identify().serial
    assert any(remark.subject == "line" and remark.verdict == "warning" for remark in arm.examine())
    with pytest.raises(DeviceError, match="power off"):
        arm.start()
    bench.clear("power-off")
    bench.wait_until(lambda: arm._link.tracking.state.robot_mode == 7)
    assert abs(arm.position_m()) < 1e-3


def test_a_tool_beside_the_line_or_turned_against_it_is_not_moved(bench):
    begun_s = bench.clock.now()
    for keys, words in [
        ({"origin_m": (-0.35, -0.4, 0.32)}, r"device arm: its tool stands 20\.0 mm beside the line"),
        ({"orientation_rad": (0.0, 3.0, 0.0)}, r"device arm: its tool is turned by 8\.0 deg"),
    ]:
        bench.driver = arm = another(bench, **keys)
        arm.open()
        with pytest.raises(DeviceError, match=words):
            arm.travel(0.1, 0.05)
        arm.close()
    assert since(bench, "command", begun_s) == []


def test_local_control_is_refused_before_and_after_the_fact(e_bench):
    bench, begun_s = e_bench, e_bench.clock.now()
    arm = bench.driver
    arm.open()
    bench.inject("local-mode")
    for look in (arm.health, lambda: arm.travel(0.1, 0.05)):
        words = error_of(bench, look)
        assert "local control" in words
        assert "Remote Control" in words
    arm._link.dashboard.remote_control = lambda: True  # switched between the question and the program
    arm.travel(0.1, 0.05)
    assert "did not begin the move" in error_of(bench, arm.position_m)
    del arm._link.dashboard.remote_control
    assert since(bench, "command", begun_s) == []
    bench.clear("local-mode")
    arm.safe_stop()
    begin(bench)  # over a new connection: the old one stays deaf


def test_under_local_control_a_safe_stop_still_stops_by_silence(e_bench):
    bench, begun_s = e_bench, e_bench.clock.now()
    bench.driver = another(bench, watchdog_ms=300)
    arm = moving(bench)
    bench.inject("local-mode")
    arm.safe_stop()
    bench.wait_for("watchdog", after_s=begun_s)
    bench.wait_for("still", after_s=begun_s)
    assert {line["what"].strip() for line in since(bench, "ignored", begun_s)} == {
        "stopl(2.0)",
        "dashboard stop",
    }


def test_a_slow_speed_slider_refuses_a_move_and_slow_scaling_ends_one(bench):
    arm = bench.driver
    arm.open()
    bench.inject("speed-slider", 0.5)
    bench.wait_until(lambda: arm._link.tracking.state.slider < 1)
    assert "speed slider stands at 50 %" in error_of(bench, lambda: arm.travel(0.1, 0.05))
    bench.clear("speed-slider")
    bench.wait_until(lambda: arm._link.tracking.state.slider == 1)
    arm.start()
    begin(bench)
    bench.inject("speed-scaling", 0.5)
    assert "moves at 50 % of the commanded speed" in error_of(bench, arm.read)


def test_a_slow_speed_slider_can_be_only_noted(bench):
    bench.inject("speed-slider", 0.5)
    bench.driver = arm = another(bench, on_reduced_speed="note", tool_channels=True)
    arm.open()
    arm.start()
    here_m = arm.position_m()
    arm.travel(here_m + (0.04 if here_m < 0.3 else -0.04), 0.1)
    arrived(bench)
    assert arm.read().values[:, -1].max() == 0.0  # no sample is at the speed asked for
    notes = "; ".join(arm.health().notes)
    assert "speed slider at 50 %" in notes
    assert "0 % of its samples at constant speed, speed scaled to 50 %" in notes


def test_a_program_that_a_person_stops_or_pauses_is_told(bench):
    arm = moving(bench)
    bench.clock.sleep(0.6)
    bench.inject("pendant-stop", 1)
    words = error_of(bench, arm.position_m)
    assert "its program ended at 0." in words
    assert "before 0." in words
    arm.safe_stop()
    begin(bench)
    bench.inject("pendant-pause", 1)
    assert "paused" in error_of(bench, arm.position_m)
    arm.safe_stop()
    assert works_again(bench)


def test_what_the_controller_says_about_a_program_is_passed_on(bench):
    begun_s = bench.clock.now()
    far = bench.driver._settings.limits.model_copy(update={"travel_m": (0.0, 3.0)})
    bench.driver = arm = another(bench, limits=far)
    arm.open()
    arm.travel(2.0, 0.1)
    words = error_of(bench, arm.position_m)
    assert "complains about the move: line 1, column 1: the pose is out of reach" in words
    stranger = Connection("arm", "script port", "127.0.0.1", arm._settings.script_port)
    stranger.open()
    stranger.write(b"def evil():\n  powerdown()\nend\n")
    bench.wait_until(lambda: len(since(bench, "program error", begun_s)) == 2)
    stranger.close()
    assert since(bench, "command", begun_s) == []
