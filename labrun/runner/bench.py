"""The bench while it runs: everything that waits goes through here, and looks at every sample and pose meanwhile."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from labrun.devices import Clock, Excess, Health, Limits, Samples, Sensor, Trajectory
from labrun.errors import DeviceError, LimitExceededError
from labrun.runner.motion import smooth_move
from labrun.runner.rig import Rig
from labrun.runner.safety import DeviceCalls, NonsenseError, SilentDeviceError, wrong_answer

_SILENT_PERIODS = 5.0
_SILENT_S = 0.5
_LEAST_DOUBLED = 4
"""Two equal samples may be a still bench; two pairs of them in a row of two are not."""
_PLAUSIBLE = {
    "N": 1e6,
    "N m": 1e6,
    "rad": 1e5,
    "rad/s": 1e6,
    "m": 1e4,
    "m/s": 1e4,
    "degC": 1e3,
    "V": 1e6,
    "A": 1e5,
}
"""Beyond these a value is no measurement of a laboratory bench, but garbage from the wire."""
_PLAUSIBLE_OTHER = 1e12


class SensorWatch:
    """Reads a sensor, and raises faults as errors that name the device.

    Parameters
    ----------
    limits
        Bounds on its samples by unit.
    calls
        Surrounds every call of the driver.
    """

    def __init__(self, name: str, sensor: Sensor, limits: Limits, clock: Clock, calls: DeviceCalls) -> None:
        self.name = name
        self._calls = calls
        self.sensor = sensor
        self._limits = limits
        self._clock = clock
        self._silence_s = max(_SILENT_PERIODS / sensor.rate_hz, _SILENT_S)
        self._last_s = -math.inf
        self._last_device_s = -math.inf
        bounds = {"N": limits.force_n, "N m": limits.torque_n_m, "degC": limits.temperature_c}
        ceiling = []
        for channel in sensor.channels:
            plausible = _PLAUSIBLE.get(channel.unit, _PLAUSIBLE_OTHER)
            bound = bounds.get(channel.unit)
            ceiling.append(plausible if bound is None else min(plausible, bound))
        self._ceiling = np.array(ceiling)
        self._plausible = np.array([_PLAUSIBLE.get(c.unit, _PLAUSIBLE_OTHER) for c in sensor.channels])
        self.running = False

    def start(self) -> None:
        """Begin to stream."""
        with self._calls(self.name, "start"):
            self.sensor.start()
        self._last_s, self._last_device_s = self._clock.now(), -math.inf
        self.running = True

    def stop(self) -> None:
        """End the stream."""
        if self.running:
            self.running = False
            with self._calls(self.name, "stop"):
                self.sensor.stop()

    def read(self) -> Samples:
        """Return the samples since the last look.

        Raises
        ------
        SilentDeviceError
            No sample for longer than five periods (at least 0.5 s).
        NonsenseError
            Not finite, beyond anything plausible, of a wrong shape, or with time running backwards.
        LimitExceededError
            A sample beyond the device's limits; names channel, value, bound and time.
        """
        with self._calls(self.name, "read"):
            block = self.sensor.read()
        if not isinstance(block, Samples):
            raise wrong_answer(self.name, "read", block, "Samples")
        now_s = self._clock.now()
        if len(block) == 0:
            quiet_s = now_s - self._last_s
            if quiet_s > self._silence_s:
                raise SilentDeviceError(
                    self.name,
                    f"stopped answering: no sample for {quiet_s:.2g} s at {self.sensor.rate_hz:g} samples/s",
                    hint="check its cable and power; labrun resume continues once it answers",
                )
            return block
        self._check_shape(block)
        self._check_once(block)
        self._last_s, self._last_device_s = float(block.host_time_s[-1]), float(block.device_time_s[-1])
        # One comparison covers NaN, infinity, plausibility and limits; what exactly is wrong is found only when it is.
        if not (np.abs(block.values).max(axis=0) <= self._ceiling).all():
            self._check_values(block)
        return block

    def _check_shape(self, block: Samples) -> None:
        count = len(block.host_time_s)
        wanted = (count, len(self.sensor.channels))
        if block.values.shape != wanted or len(block.device_time_s) != count:
            raise NonsenseError(
                self.name,
                f"answered a block of shape {block.values.shape} with {len(block.device_time_s)} device times "
                f"and {count} host times; expected {wanted}",
                hint="this is a fault of its driver",
            )
        if (
            not math.isfinite(float(block.host_time_s[-1]))
            or block.host_time_s[0] < self._last_s - self._silence_s
        ):
            raise NonsenseError(self.name, "its samples' receive times run backwards or are not finite")

    def _check_once(self, block: Samples) -> None:
        """Raise NonsenseError where samples stand twice in the block, or were in an earlier one."""
        first_s, first_device_s = float(block.host_time_s[0]), float(block.device_time_s[0])
        count = len(block)
        again = first_s < self._last_s and first_device_s <= self._last_device_s
        pairs = (
            count >= _LEAST_DOUBLED
            and count % 2 == 0
            and np.array_equal(block.host_time_s[::2], block.host_time_s[1::2])
            and np.array_equal(block.device_time_s[::2], block.device_time_s[1::2])
            and np.array_equal(block.values[::2], block.values[1::2])
            and bool((np.diff(block.host_time_s[::2]) > 0.0).all())
        )
        if again or pairs:
            what = "samples that it had returned before" if again else "every sample twice"
            raise NonsenseError(
                self.name,
                f"its read() returned {what}; expected the samples since the last call, each once",
                hint="this is a fault of its driver",
            )

    def _check_values(self, block: Samples) -> None:
        bad = ~(np.abs(block.values) <= self._plausible)
        if bad.any():
            row, column = (int(i) for i in np.argwhere(bad)[0])
            channel = self.sensor.channels[column]
            nonsense = NonsenseError(
                self.name,
                f"sent an implausible value: {channel.name} = {block.values[row, column]:g} {channel.unit}",
                hint="check its wiring, its supply and its driver's settings",
            )
            nonsense.clock_s = float(block.host_time_s[row])
            raise nonsense
        for excess in self._limits.sample_excess(self.sensor.channels, block.host_time_s, block.values):
            raise limit_error(self.name, excess)


def limit_error(device: str, excess: Excess, *, time_s: float | None = None) -> LimitExceededError:
    """Return the error for a limit that was left while the rig was moving."""
    error = LimitExceededError(
        device,
        str(excess),
        hint="actuators are stopped; look at the bench before labrun resume, or change the limit in the file",
    )
    error.clock_s = excess.time_s if time_s is None else time_s
    return error


_POSE_EVERY_S = 0.25
_HEALTH_EVERY_S = 5.0
"""A motor heats up in tens of seconds; asking more often would only load its bus."""
_SPEED_SLACK = 1.25
"""Measured speed over its limit: poses are not taken at the very moment they are asked for. A distance of
`_POSE_SLACK_RAD` between two poses comes on top, for their noise."""
_POSE_SLACK_RAD = float(np.radians(3.0))
"""How far a measured pose may stand beyond its limit: overshoot and play, not a runaway."""
_TRAVEL_SLACK_M = 2e-3
_ARRIVED_M = 1e-3

Handle = Callable[[Mapping[str, Samples]], object]


class Bench:
    """Waits on the clock and watches the rig meanwhile.

    Parameters
    ----------
    check_stop
        Raises Interrupted if someone asked to stop.
    beat
        Called at every look: tells the watchdog that the runner lives.
    """

    def __init__(
        self, rig: Rig, clock: Clock, check_stop: Callable[[], None], beat: Callable[[], object]
    ) -> None:
        self.rig = rig
        self.clock = clock
        self.check_stop = check_stop
        self._beat = beat
        self._watches = {
            n: SensorWatch(n, s, rig.limits[n], clock, rig.calls) for n, s in rig.sensors.items()
        }
        self._pose_due_s = -np.inf
        self._health_due_s = -np.inf
        self._poses: dict[str, tuple[float, Mapping[str, float]]] = {}

    def snapshot(self) -> dict[str, Any]:
        """Return the time and the state of a simulated rig, JSON-ready."""
        return {"clock_s": self.clock.now(), **self.rig.snapshot()}

    def restore(self, memory: Mapping[str, Any]) -> None:
        """Take back what `snapshot` gave; a real clock and a real bench keep their own state."""
        if self.rig.dry_run:
            if hasattr(self.clock, "time_s"):
                self.clock.time_s = memory["clock_s"]
            self.rig.restore(memory)

    def start_sensors(self) -> None:
        """Begin all streams."""
        for watch in self._watches.values():
            watch.start()

    def stop_sensors(self) -> None:
        """End all streams, even if one fails to; the first failure is raised at the end."""
        failure: Exception | None = None
        for watch in self._watches.values():
            try:
                watch.stop()
            except Exception as error:  # every sensor gets its stop
                failure = failure or error
        if failure is not None:
            raise failure

    def look(self) -> dict[str, Samples]:
        """Check whether to stop, every sensor's new samples, poses, travel and health; return the samples.

        Raises
        ------
        Interrupted
            Someone asked to stop.
        DeviceError
            A device fell silent, answered nonsense, is not well, or left a limit.
        """
        self.check_stop()
        self._beat()
        blocks = {name: watch.read() for name, watch in self._watches.items() if watch.running}
        now_s = self.clock.now()
        if now_s >= self._pose_due_s:
            self._pose_due_s = now_s + _POSE_EVERY_S
            self._check_poses(now_s)
        if now_s >= self._health_due_s:
            self.check_health()
        return blocks

    def watch(self, until_s: float, handle: Handle | None = None) -> None:
        """Wait until a time on the clock, looking at everything every `clock.poll_s`."""
        while (left_s := until_s - self.clock.now()) > 0:
            self.clock.sleep(min(self.clock.poll_s, left_s))
            blocks = self.look()
            if handle is not None:
                handle(blocks)

    def move(self, goal_rad: Mapping[str, float], speed_rad_s: float) -> None:
        """Bring joints to a pose smoothly, within limits, and wait until they are there."""
        until_s = self.clock.now()
        moved: list[str] = []
        for name, actuator in self.rig.actuators.items():
            wanted = {joint: goal_rad[joint] for joint in actuator.joints if joint in goal_rad}
            if not wanted:
                continue
            limits = self.rig.limits[name]
            ceiling = (
                speed_rad_s
                if limits.speed_deg_s is None
                else min(speed_rad_s, np.radians(limits.speed_deg_s))
            )
            pose = self._pose(name)
            move = smooth_move(pose, wanted, float(ceiling))
            if move is None:
                continue
            for excess in limits.trajectory_excess(move):
                if _leads_back(excess, move):
                    continue
                raise limit_error(name, excess, time_s=self.clock.now() + excess.time_s)
            start_s = self.clock.now()
            with self.rig.calls(name, "follow"):
                actuator.follow(_complete(move, actuator.joints, pose), start_s)
            until_s = max(until_s, start_s + move.duration_s)
            moved.append(name)
        self.watch(until_s)
        while not all(self._arrived(name) for name in moved):
            self.watch(self.clock.now() + self.clock.poll_s)

    def wait_for_arrangements(self) -> None:
        """Wait until the condition of the next trial is in place."""
        while not all(self._arrived(name) for name in self.rig.arranging):
            self.watch(self.clock.now() + self.clock.poll_s)

    def follow(self, trajectory: Trajectory, start_s: float) -> None:
        """Send every actuator its part of a motion, after a last check against its limits."""
        parts = []
        for name, actuator in self.rig.actuators.items():
            joints = tuple(joint for joint in actuator.joints if joint in trajectory.joints)
            if not joints:
                continue
            part = trajectory.only(joints)
            for excess in self.rig.limits[name].trajectory_excess(part):
                raise limit_error(name, excess, time_s=start_s + excess.time_s)
            still = self._pose(name) if joints != actuator.joints else {}
            parts.append((name, _complete(part, actuator.joints, still)))
        for name, part in parts:
            with self.rig.calls(name, "follow"):
                self.rig.actuators[name].follow(part, start_s)

    def travel(
        self, device: str, to_m: float, speed_m_s: float, acceleration_m_s2: float | None = None
    ) -> None:
        """Start a move of the carriage, after a last check against its limits; with its own acceleration if None."""
        for excess in self.rig.limits[device].travel_excess(to_m, speed_m_s):
            raise limit_error(device, excess, time_s=self.clock.now())
        with self.rig.calls(device, "travel"):
            carriage = self.rig.carriages[device]
            if acceleration_m_s2 is None:
                carriage.travel(to_m, speed_m_s)
            else:
                carriage.travel(to_m, speed_m_s, acceleration_m_s2)

    def travel_and_wait(
        self, device: str, to_m: float, speed_m_s: float, acceleration_m_s2: float | None = None
    ) -> None:
        """Move the carriage and wait until it has arrived."""
        distance_m = abs(self._position_m(device) - to_m)
        if distance_m <= _ARRIVED_M:
            return
        self.travel(device, to_m, speed_m_s, acceleration_m_s2)
        deadline_s = self.clock.now() + 2.0 * distance_m / speed_m_s + 5.0
        self.watch(self.clock.now() + distance_m / speed_m_s)
        while abs(self._position_m(device) - to_m) > _ARRIVED_M:
            if self.clock.now() > deadline_s:
                raise SilentDeviceError(
                    device,
                    f"did not arrive: it stands at {self._position_m(device):.4g} m, {to_m:.4g} m was commanded",
                    hint="look for an obstacle or a protective stop of the carriage",
                )
            self.watch(self.clock.now() + min(self.clock.poll_s, 0.1))

    def check_health(self) -> None:
        """Ask every device how it is; DeviceError if one is not well, LimitExceededError if one is too hot."""
        self._health_due_s = self.clock.now() + _HEALTH_EVERY_S
        for name, device in self.rig.devices.items():
            with self.rig.calls(name, "health"):
                health = device.health()
            if not isinstance(health, Health):
                raise wrong_answer(name, "health", health, "Health")
            bound = self.rig.limits[name].temperature_c
            if bound is not None and health.temperature_c is not None and not health.temperature_c <= bound:
                raise limit_error(
                    name, Excess("temperature", health.temperature_c, bound, "degC", self.clock.now())
                )
            if not health.ok:
                notes = "; ".join(health.notes) or "no reason given"
                raise DeviceError(
                    name, f"reports a fault: {notes}", hint="see its manual for the state it reports"
                )

    def _arrived(self, name: str) -> bool:
        """Tell whether a move has ended: when its time is over, unless the device (person, slider) says it itself."""
        device = self.rig.arranging.get(name)
        if device is None:
            return True
        with self.rig.calls(name, "arrived"):
            return device.arrived()

    def _pose(self, name: str) -> Mapping[str, float]:
        """Return where an actuator's joints are, rad; DeviceError if it cannot say."""
        actuator = self.rig.actuators[name]
        with self.rig.calls(name, "pose"):
            pose = actuator.pose()
        if not isinstance(pose, Mapping) or any(joint not in pose for joint in actuator.joints):
            raise wrong_answer(name, "pose", pose, f"an angle for each of {', '.join(actuator.joints)}")
        for joint, angle in pose.items():
            if not math.isfinite(angle):
                raise NonsenseError(name, f"reports joint {joint} at {angle} rad", hint="check its sensor")
        return pose

    def _position_m(self, name: str) -> float:
        with self.rig.calls(name, "position_m"):
            position = self.rig.carriages[name].position_m()
        if not isinstance(position, int | float | np.floating):
            raise wrong_answer(name, "position_m", position, "a number")
        if not math.isfinite(position):
            raise NonsenseError(name, f"reports a position of {position} m", hint="check its controller")
        return position

    def _check_poses(self, now_s: float) -> None:
        for name in self.rig.actuators:
            limits = self.rig.limits[name]
            if limits.angle_deg is None and limits.speed_deg_s is None:
                continue
            pose = self._pose(name)
            if limits.speed_deg_s is not None:
                self._check_speeds(name, pose, limits.speed_deg_s)
            bounds = limits.angle_deg
            if bounds is None:
                continue
            low, high = math.radians(bounds[0]), math.radians(bounds[1])
            for joint, angle in pose.items():
                if not low - _POSE_SLACK_RAD <= angle <= high + _POSE_SLACK_RAD:
                    bound = bounds[1] if angle > high else bounds[0]
                    excess = Excess(
                        f"measured angle of {joint}", float(np.degrees(angle)), bound, "deg", now_s
                    )
                    raise limit_error(name, excess)
        for name, carriage in self.rig.carriages.items():
            travel = self.rig.limits[name].travel_m or carriage.travel_m
            position = self._position_m(name)
            if not travel[0] - _TRAVEL_SLACK_M <= position <= travel[1] + _TRAVEL_SLACK_M:
                bound = travel[1] if position > travel[1] else travel[0]
                raise limit_error(name, Excess("position", position, bound, "m", now_s))

    def _check_speeds(self, name: str, pose: Mapping[str, float], bound_deg_s: float) -> None:
        """Compare the way since the last pose with what the limit allows in that time."""
        now_s = self.clock.now()  # after the answer: a slow bus must not make a joint look fast
        before_s, before = self._poses.get(name, (now_s, pose))
        self._poses[name] = (now_s, dict(pose))
        passed_s = now_s - before_s
        if passed_s <= 0.0:
            return
        allowed_rad = _SPEED_SLACK * math.radians(bound_deg_s) * passed_s + _POSE_SLACK_RAD
        for joint, angle in pose.items():
            way = angle - before.get(joint, angle)
            if abs(way) > allowed_rad:
                speed = float(np.degrees(way)) / passed_s
                bound = math.copysign(bound_deg_s, speed)
                raise limit_error(name, Excess(f"measured speed of {joint}", speed, bound, "deg/s", now_s))


def _leads_back(excess: Excess, move: Trajectory) -> bool:
    """Tell whether a move leaves its limit only because it begins outside and goes home."""
    return excess.unit == "deg" and math.isfinite(excess.value) and excess.time_s <= float(move.time_s[0])


def _complete(part: Trajectory, joints: tuple[str, ...], pose: Mapping[str, float]) -> Trajectory:
    """Return a motion of all of an actuator's joints, in their order; those that are not moved hold their pose."""
    if part.joints == joints:
        return part
    columns = [
        part.angle_rad[:, part.joints.index(joint)]
        if joint in part.joints
        else np.full(len(part.time_s), pose[joint])
        for joint in joints
    ]
    return Trajectory(joints, part.time_s, np.column_stack(columns), part.period_s)
