"""A small bench of a third party: a paddle in a pond, its servo, its force cell and its carriage, named by dotted name.

Real devices of labrun's protocols, with bad days on request; the runner's tests run on it from outside, as any plugin
would be run.
"""

import collections
import itertools
import os
import time
from pathlib import Path

import numpy as np

from labrun.devices import Channel, DeviceError, DeviceSettings, Health, Identity, Samples, Trajectory


def witness(path, text):
    """Append a line to a log that survives the death of the process."""
    if path is not None:
        with Path(path).open("a") as file:
            file.write(text + "\n")


def hang(holding):
    """Do not return for a minute; for ever and `holding` the lock of the interpreter, as a faulty driver in C may."""
    if holding:
        collections.deque(itertools.repeat(0), maxlen=0)
    else:
        time.sleep(60)


class Pond:
    """Closed form: force = 0.2 + gain * angle rate, plus an echo that dies out after each motion."""

    joints = ("tail",)

    def __init__(self, settings, rng):
        self.gain = settings.get("gain", 0.5)
        self.tires_s = settings.get("tires_s")
        self.echo_n = settings.get("echo_n", 0.0)
        self.echo_hz = settings.get("echo_hz", 0.4)
        self.decay_s = settings.get("decay_s", 3.0)
        self.signals = {"force_x": "N"}
        self.motions = [[-100.0, [0.0], [0.0]]]
        self.carriage = [0.0, 0.0, 0.0, 0.0]
        self.arranged = []

    def arrange(self, condition):
        self.arranged.append(dict(condition))

    def drive(self, joint, trajectory, start_s):
        self.motions.append([start_s, trajectory.time_s.tolist(), trajectory.angle_rad[:, 0].tolist()])
        del self.motions[:-2]

    def tow(self, from_m, to_m, speed_m_s, start_s):
        self.carriage = [from_m, to_m, speed_m_s, start_s]

    def position_m(self, time_s):
        begin, end, speed, start = self.carriage
        return begin + np.sign(end - begin) * min(abs(end - begin), max(0.0, (time_s - start) * speed))

    def angle(self, time_s):
        angle = np.zeros_like(time_s)
        for start, times, angles in self.motions:
            after = time_s >= start
            angle[after] = np.interp(time_s[after] - start, times, angles)
        return angle

    def observe(self, signals, time_s):
        rate = (self.angle(time_s + 1e-3) - self.angle(time_s - 1e-3)) / 2e-3
        worn = 1.0 if self.tires_s is None else np.exp(-np.maximum(time_s, 0.0) / self.tires_s)
        force = 0.2 + self.gain * worn * rate
        for start, times, angles in self.motions:
            since = time_s - start - times[-1]
            size = self.echo_n * np.ptp(angles)
            force = force + np.where(
                since >= 0,
                size
                * np.exp(-np.maximum(since, 0) / self.decay_s)
                * np.cos(2 * np.pi * self.echo_hz * since),
                0,
            )
        return np.column_stack([force for _ in signals])

    def snapshot(self):
        return {"motions": [list(motion) for motion in self.motions], "carriage": list(self.carriage)}

    def restore(self, snapshot):
        self.motions = [list(motion) for motion in snapshot["motions"]]
        self.carriage = list(snapshot["carriage"])

    def truth(self):
        return {"gain": self.gain}


class Hoarder(Pond):
    """Keeps all of its past: 300 kB a trial."""

    def snapshot(self):
        self.past = [*getattr(self, "past", []), "x" * 300_000]
        return {**super().snapshot(), "past": self.past}


class Servo:
    """Drives the pond's tail, or nothing where there is no pond."""

    class Settings(DeviceSettings):
        """With a log of every stop."""

        port: str = ""
        stop_log: str | None = None
        hang_after_s: float | None = None
        hang_holding: bool = False
        temperature_c: float = 25.0
        runaway_after_s: float | None = None
        stop_fails: bool = False
        pose_fails_after_s: float | None = None
        hot_after_s: float | None = None
        dash_after_s: float | None = None
        open_log: str | None = None
        reopen_fails: bool = False
        identify_fails: bool = False
        stop_hangs_s: float = 0.0
        restarts_after_s: float | None = None

    def __init__(self, name, settings, context):
        self.name = name
        self.joints = ("tail",)
        self.settings = settings
        self.clock = context.clock
        self.scene = context.scene
        self.angle_rad = 0.0
        self.moves = []
        self.opened_s = None
        self.side = 1.0

    def open(self):
        witness(self.settings.open_log, f"open {self.name}")
        if self.opened_s is not None and self.settings.reopen_fails:
            raise OSError("the port is gone")
        self.opened_s = self.clock.now()

    def identify(self):
        if self.settings.identify_fails:
            raise OSError("no answer")
        return Identity("pond servo", serial="1")

    def health(self):
        restarts = self.settings.restarts_after_s
        if restarts is not None and self.clock.now() - self.opened_s > restarts:
            return Health(ok=False, notes=("it restarted, its torque is off",))
        hot = self.settings.hot_after_s
        if hot is not None and self.clock.now() - self.opened_s > hot:
            return Health(temperature_c=90.0)
        return Health(temperature_c=self.settings.temperature_c)

    def safe_stop(self):
        witness(self.settings.stop_log, f"safe_stop {self.name} {os.getpid()}")
        time.sleep(self.settings.stop_hangs_s)
        if self.settings.stop_fails:
            raise OSError("the cable is gone")

    def close(self):
        pass

    def pose(self):
        after = self.settings.hang_after_s
        if after is not None and self.clock.now() - self.opened_s > after:
            hang(self.settings.hang_holding)
        fails = self.settings.pose_fails_after_s
        if fails is not None and self.clock.now() - self.opened_s > fails:
            raise OSError("the cable is gone")
        runaway = self.settings.runaway_after_s
        if runaway is not None and self.clock.now() - self.opened_s > runaway:
            return {"tail": 3.0}
        dash = self.settings.dash_after_s
        if dash is not None and self.clock.now() - self.opened_s > dash:
            self.side = -self.side
            return {"tail": self.side}
        return {"tail": self.angle_rad}

    def follow(self, trajectory: Trajectory, start_s):
        witness(self.settings.stop_log, f"follow {self.name}")
        self.moves.append((start_s, trajectory))
        self.angle_rad = float(trajectory.angle_rad[-1, 0])
        if self.scene is not None:
            self.scene.drive("tail", trajectory, start_s)

    def snapshot(self):
        return {"angle_rad": self.angle_rad}

    def restore(self, snapshot):
        self.angle_rad = snapshot["angle_rad"]

    @classmethod
    def emergency_stop(cls, name, settings):
        witness(settings.stop_log, f"emergency_stop {name} {os.getpid()}")


class EncoderServo(Servo):
    """Measures its joint at 100 samples/s; it lags, and jams where it is told to."""

    class Settings(Servo.Settings):
        """With the times on the clock between which the joint is blocked."""

        jams_s: tuple[float, float] = (1e9, 1e9)
        lag_s: float = 0.02

    channels = (Channel("tail_angle", "rad"),)
    rate_hz = 100.0

    def start(self):
        self.next_s = self.clock.now()

    def read(self):
        count = int((self.clock.now() - self.next_s) * self.rate_hz + 1e-6)
        times = self.next_s + np.arange(count) / self.rate_hz
        self.next_s += count / self.rate_hz
        begin, end = self.settings.jams_s
        free = np.where((times > begin) & (times < end), begin, times)
        return Samples(times, times, self.scene.angle(free - self.settings.lag_s)[:, None])

    def stop(self):
        pass


class Cell:
    """Measures the pond's force with noise at 100 samples/s."""

    class Settings(DeviceSettings):
        """With bad days, counted in calls of `start` (trials) or by the clock."""

        noise_n: float = 0.01
        rate_hz: float = 100.0
        silent_after_s: float | None = None
        nan_after_s: float | None = None
        bad_shape: bool = False
        saturated_trials: tuple[int, ...] = ()
        lossy_trials: tuple[int, ...] = ()
        spike_trials: tuple[int, ...] = ()
        silent_trials: tuple[int, ...] = ()
        silent_times: int = 99
        open_fails: bool = False
        hang_after_s: float | None = None
        hang_holding: bool = False
        read_answers: str = ""
        health_answers: str = ""

    def __init__(self, name, settings, context):
        self.name = name
        self.settings = settings
        self.clock = context.clock
        self.rng = context.rng
        self.scene = context.scene
        self.channels = (Channel("force_x", "N"),)
        self.rate_hz = settings.rate_hz
        self.trial = -1
        self.silences = 0
        self.opened = 0

    def open(self):
        if self.settings.open_fails:
            raise DeviceError(self.name, "does not answer", hint="is it switched on?")
        self.opened += 1
        self.opened_s = self.clock.now()

    def identify(self):
        return Identity("pond cell")

    def health(self):
        return {"": Health(), "none": None, "list": []}[self.settings.health_answers]

    def safe_stop(self):
        pass

    def close(self):
        pass

    def reseed(self, seed):
        self.trial = int(seed.entropy[1])
        self.rng = np.random.default_rng(seed)

    def start(self):
        self.next_s = self.clock.now()
        self.silent = self.trial in self.settings.silent_trials and self.silences < self.settings.silent_times
        self.silences += self.silent

    def stop(self):
        pass

    def read(self):
        now = self.clock.now()
        age = now - self.opened_s
        if self.settings.hang_after_s is not None and age > self.settings.hang_after_s:
            hang(self.settings.hang_holding)
        if self.silent or (self.settings.silent_after_s is not None and age > self.settings.silent_after_s):
            return Samples.empty(1)
        count = int((now - self.next_s) * self.rate_hz + 1e-6)
        times = self.next_s + np.arange(count) / self.rate_hz
        self.next_s += count / self.rate_hz
        force = np.full(count, 0.2) if self.scene is None else self.scene.observe(("force_x",), times)[:, 0]
        values = (force + self.settings.noise_n * self.rng.standard_normal(count))[:, None]
        if self.trial in self.settings.spike_trials:
            values = values + 5.0
        if self.settings.nan_after_s is not None and age > self.settings.nan_after_s and count:
            values[0] = np.nan
        if self.settings.bad_shape:
            values = np.hstack([values, values])
        saturated = 3 if self.trial in self.settings.saturated_trials else 0
        lost = count if self.trial in self.settings.lossy_trials else 0
        block = Samples(times - 5.0, times + 0.002, values, lost=lost, saturated=saturated)
        if self.settings.read_answers == "again" and count:
            self.next_s -= 2 / self.rate_hz
        twice = Samples(*(np.repeat(part, 2, axis=0) for part in (times - 5.0, times + 0.002, values)))
        return {"none": None, "list": [block], "doubled": twice}.get(self.settings.read_answers, block)


class Sledge:
    """The carriage."""

    class Settings(DeviceSettings):
        """With an obstacle, if one is asked for."""

        obstacle_m: float | None = None

    travel_m = (0.0, 1.0)

    def __init__(self, name, settings, context):
        self.name = name
        self.settings = settings
        self.clock = context.clock
        self.scene = context.scene
        self.travels = []

    def open(self):
        pass

    def identify(self):
        return Identity("pond sledge")

    def health(self):
        return Health()

    def safe_stop(self):
        pass

    def close(self):
        pass

    def position_m(self):
        position = float(self.scene.position_m(self.clock.now()))
        obstacle = self.settings.obstacle_m
        return position if obstacle is None else max(position, obstacle)

    def travel(self, to_m, speed_m_s):
        self.travels.append((self.clock.now(), to_m, speed_m_s))
        self.scene.tow(self.position_m(), to_m, speed_m_s, self.clock.now())
