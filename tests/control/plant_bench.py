"""A bench of a third party for closed loops: two joints that do as they are told, and a sensor that sees them.

What the sensor sees is the angle in rad, and `push_rad` on top of it on the first joint.
"""

import time

import numpy as np

from labrun.devices import Channel, DeviceSettings, Health, Identity, Samples


class Plant:
    """Angles as commanded."""

    joints = ("roll", "pitch")

    def __init__(self, settings, rng):
        self.signals = {"roll": "rad", "pitch": "rad"}
        self.push_rad = settings.get("push_rad", 0.0)
        self.moves = {joint: [] for joint in self.joints}

    def arrange(self, condition):
        pass

    def drive(self, joint, trajectory, start_s):
        column = trajectory.angle_rad[:, trajectory.joints.index(joint)]
        self.moves[joint].append((start_s, trajectory.time_s.tolist(), column.tolist()))
        del self.moves[joint][:-4]

    def observe(self, signals, time_s):
        observe = np.zeros((len(time_s), len(signals)))
        for number, joint in enumerate(signals):
            for start_s, times, angles in self.moves[joint]:
                after = time_s >= start_s
                observe[after, number] = np.interp(time_s[after] - start_s, times, angles)
            if joint == "roll":
                observe[:, number] += self.push_rad
        return observe

    def snapshot(self):
        return {"moves": {joint: [list(move) for move in moves] for joint, moves in self.moves.items()}}

    def restore(self, snapshot):
        self.moves = {joint: [tuple(move) for move in moves] for joint, moves in snapshot["moves"].items()}

    def truth(self):
        return {}


class _Device:
    class Settings(DeviceSettings):
        """Plain."""

    def __init__(self, name, settings, context):
        self.name = name
        self.settings = settings
        self.clock = context.clock
        self.scene = context.scene

    def open(self):
        pass

    def identify(self):
        return Identity("plant bench")

    def health(self):
        return Health()

    def safe_stop(self):
        pass

    def close(self):
        pass


class Servos(_Device):
    """Drives both joints; keeps everything it was told."""

    joints = ("roll", "pitch")

    def __init__(self, name, settings, context):
        super().__init__(name, settings, context)
        self.moves = []

    def pose(self):
        now_s = self.clock.now()
        if not self.moves:
            return dict.fromkeys(self.joints, 0.0)
        start_s, trajectory = self.moves[-1]
        return dict(zip(trajectory.joints, trajectory.at(now_s - start_s)[0], strict=True))

    def follow(self, trajectory, start_s):
        self.moves.append((start_s, trajectory))
        for joint in self.joints:
            self.scene.drive(joint, trajectory, start_s)

    def snapshot(self):
        return {"pose": {joint: float(angle) for joint, angle in self.pose().items()}}

    def restore(self, snapshot):
        from labrun.devices import Trajectory

        angles = np.array([[snapshot["pose"][joint] for joint in self.joints]])
        self.moves = [(0.0, Trajectory(self.joints, np.zeros(1), angles))]


class Eye(_Device):
    """Sees both joints 100 times a second, with noise."""

    class Settings(DeviceSettings):
        """With noise."""

        noise_rad: float = 0.0

    channels = (Channel("roll", "rad"), Channel("pitch", "rad"))
    rate_hz = 100.0

    def __init__(self, name, settings, context):
        super().__init__(name, settings, context)
        self.rng = context.rng

    def reseed(self, seed):
        self.rng = np.random.default_rng(seed)

    def start(self):
        self.next_s = self.clock.now()

    def stop(self):
        pass

    def read(self):
        count = max(0, int((self.clock.now() - self.next_s) * self.rate_hz + 1e-6))
        times = self.next_s + np.arange(count) / self.rate_hz
        self.next_s += count / self.rate_hz
        seen = self.scene.observe(("roll", "pitch"), times)
        return Samples(times, times, seen + self.settings.noise_rad * self.rng.standard_normal(seen.shape))


class SlowController:
    """Thinks for as long as it is told to; then asks for what it is told to."""

    def __init__(self, settings, context):
        self.think_s = settings["think_s"]
        self.value = settings.get("value", 0.0)

    def update(self, step):
        time.sleep(self.think_s)
        return self.value

    def applied(self, drive):
        pass


class WildController:
    """Asks for far beyond one end of the range, then for far beyond the other."""

    def __init__(self, settings, context):
        self.given = []
        self.sign = 1.0

    def update(self, step):
        self.sign = -self.sign
        return self.sign * 1e6

    def applied(self, drive):
        self.given.append(drive)


class LostController(WildController):
    """Asks for nothing that is a number."""

    def update(self, step):
        return float("nan")
