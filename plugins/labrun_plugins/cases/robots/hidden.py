"""What can be hidden in a joint: forms of their own, in another shape than the library's where there is one."""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

EFFECTS = (
    "coulomb-friction", "stribeck-friction", "load-dependent-friction", "gear-efficiency", "cogging",
    "torque-speed-limit", "warming-friction", "elastic-transmission", "loop-delay", "delay", "play",
    "drive-gain", "drive-play", "gravity-compensation", "dynamics-feedforward", "integral-term", "motion-profile",
    "torque-limit", "asymmetric-damping", "constant-force",
)  # fmt: skip
"""By the name that a right answer gives."""
KNOWN_TO_THE_CONTROLLER = ("gravity-compensation", "dynamics-feedforward")


_PROFILE_STEPS = 20
_STIFF = 30.0
"""How much stiffer a gear is, once its play is taken up, than the servo's gain."""


@dataclass
class Joint:
    """A joint's drive with what is hidden in it, one step after the other.

    Attributes
    ----------
    sizes
        By effect: one number, in the unit that `draw` says.
    rate_scale
        Typical peak speed of the joint.
    """

    kp: float
    kv: float
    armature: float
    dt: float
    rate_scale: float
    sizes: dict[str, float]
    shape: dict[str, float]
    _bristle: float = 0.0
    _motor: list[float] | None = None
    _middle: list[float] | None = None
    _late: dict[str, deque[float]] = field(default_factory=dict)
    _played: float | None = None
    _sum: float = 0.0
    _sum_middle: float | None = None
    _profile: tuple[float, float] | None = None

    @property
    def two_masses(self) -> bool:
        """Tell whether its motor is a body of its own."""
        return "elastic-transmission" in self.sizes or "drive-play" in self.sizes

    def torque(self, t: float, goal: float, q: float, rate: float, planned: float = 0.0) -> float:
        """Return what drive and friction put on the link; `planned` is the torque its controller may know of."""
        sizes = self.sizes
        if "delay" in sizes:
            goal = self._delayed("delay", goal, sizes["delay"])
        if "motion-profile" in sizes:
            goal = self._profiled(goal, sizes["motion-profile"] * self.rate_scale)
        if self.two_masses:
            return self._elastic(goal, q, rate)
        drive = self.kp * (goal - q) - self.kv * rate
        drive += planned * sum(sizes.get(effect, 0.0) for effect in KNOWN_TO_THE_CONTROLLER)
        if "integral-term" in sizes:
            drive += self._integrated(self.kp * (goal - q) / sizes["integral-term"])
        if "loop-delay" in sizes:
            drive = self._delayed("loop", drive, sizes["loop-delay"])
        drive *= 1.0 + sizes.get("drive-gain", 0.0)
        if "torque-speed-limit" in sizes:
            stall = sizes["torque-speed-limit"]
            free = self.shape["free"] * self.rate_scale
            upper, lower = stall * max(1.0 - rate / free, 0.0), -stall * max(1.0 + rate / free, 0.0)
            drive = min(max(drive, min(lower, 0.0)), max(upper, 0.0))
        if "torque-limit" in sizes:
            # a current controller rounds the corner a little
            limit = sizes["torque-limit"]
            drive /= (1.0 + abs(drive / limit) ** 24) ** (1.0 / 24)
        out = drive + sizes.get("constant-force", 0.0)
        if "asymmetric-damping" in sizes:
            slow = 0.01 * self.rate_scale
            out -= sizes["asymmetric-damping"] * (np.hypot(rate, slow) - slow)
        if "gear-efficiency" in sizes:
            loss = sizes["gear-efficiency"]
            slow = rate / np.hypot(rate, 0.004 * self.rate_scale)
            # the drive's power reaches the link less a share; driven backwards, the gear keeps more of it
            out -= abs(drive) * slow * (loss if drive * rate > 0 else self.shape["backward"] * loss)
        level = self._friction(t, drive, rate)
        if level:
            out -= level * self._stick(rate)
        if "cogging" in sizes:
            angle = self.shape["periods"] * q + self.shape["phase"]
            out -= sizes["cogging"] * (np.sin(angle) + 0.15 * np.sin(2 * angle))
        return out

    def _friction(self, t: float, drive: float, rate: float) -> float:
        sizes = self.sizes
        level = sizes.get("coulomb-friction", 0.0)
        if "stribeck-friction" in sizes:
            size = sizes["stribeck-friction"]
            level += size * (0.5 + 1.0 / (1.0 + (rate / (0.06 * self.rate_scale)) ** 2))
        if "load-dependent-friction" in sizes:
            level += sizes["load-dependent-friction"] * abs(drive)
        if "warming-friction" in sizes:
            size = sizes["warming-friction"]
            level += size * (0.4 + 0.9 * np.exp(-t / self.shape["warm_s"]))
        return float(level)

    def _stick(self, rate: float) -> float:
        """Return the sign of friction from the deflection of bristles (Dahl), in units of its level."""
        reach = 2e-4
        self._bristle += self.dt * rate / reach
        self._bristle = min(max(self._bristle, -1.0), 1.0)
        return float(
            self._bristle + 0.3 * np.sqrt(reach / max(self.rate_scale, 1e-9)) * rate / self.rate_scale
        )

    def _integrated(self, slope: float) -> float:
        """Return an integral by the midpoint rule: as it is, and in turn as it is in the middle of a step."""
        if self._sum_middle is None:
            self._sum_middle = self._sum + self.dt * slope
            return self._sum
        value, self._sum_middle = self._sum_middle, None
        self._sum += 2.0 * self.dt * slope
        return value

    def _profiled(self, goal: float, top: float) -> float:
        """Return the drive's own set-point, and move it on: as fast as it may, braking in time to rest at the goal."""
        position, speed = self._profile or (goal, 0.0)
        now, h = position, self.dt / _PROFILE_STEPS
        slope = top / self.shape["ramp_s"]
        for _ in range(_PROFILE_STEPS):
            ahead = goal - position
            wanted = math.copysign(min(math.sqrt(2.0 * slope * abs(ahead)), top), ahead)
            before, speed = speed, speed + min(max(wanted - speed, -slope * h), slope * h)
            position += 0.5 * h * (before + speed)
        self._profile = (position, speed)
        return now

    def _elastic(self, goal: float, q: float, rate: float) -> float:
        """Return what a motor behind a spring, or behind play and a stiff spring, puts on the link."""
        spring = self.sizes.get("elastic-transmission", _STIFF * self.kp)
        half = 0.5 * self.sizes.get("drive-play", 0.0)
        if self._motor is None:
            self._motor = [q, rate]
        # the midpoint rule, as the links: it asks at the beginning and in the middle of a step in turn. A motor that
        # only used where each half began was early by half of it, a quarter of a millisecond
        angle, speed = self._motor if self._middle is None else self._middle
        damper = self.shape["damper"] * np.sqrt(spring * self.armature)
        bent = angle - q - min(max(angle - q, -half), half)
        through = spring * bent + (damper * (speed - rate) if bent or not half else 0.0)
        pushed = (self.kp * (goal - angle) - self.kv * speed - through) / self.armature
        begin, ahead = self._motor, self.dt if self._middle is None else 2.0 * self.dt
        there = [begin[0] + ahead * speed, begin[1] + ahead * pushed]
        if self._middle is None:
            self._middle = there
        else:
            self._motor, self._middle = there, None
        return float(through)

    def measured(self, q: float) -> float:
        """Return what the logged encoder sees."""
        if self._motor is not None and "elastic-transmission" in self.sizes:
            return self._motor[0]
        if "play" in self.sizes:
            half = self.sizes["play"] / 2
            before = q if self._played is None else self._played
            self._played = min(max(before, q - half), q + half)
            return float(self._played)
        return q

    def _delayed(self, name: str, value: float, delay: float) -> float:
        steps = delay / self.dt
        line = self._late.setdefault(name, deque(maxlen=int(steps) + 2))
        line.append(value)
        if len(line) < int(steps) + 2:
            return float(line[0])
        share = steps - int(steps)
        return share * line[0] + (1 - share) * line[1]


def draw_size(effect: str, rng: np.random.Generator, torque: float, travel: float, rate: float) -> float:
    """Return a size that such joints have, SI: a profile's in units of the joint's peak speed."""
    share = float(np.exp(rng.uniform(np.log(0.5), np.log(2.0))))
    return {
        "coulomb-friction": 0.08 * torque * share,
        "stribeck-friction": 0.06 * torque * share,
        "load-dependent-friction": 0.12 * share,
        "gear-efficiency": 0.12 * share,
        "cogging": 0.06 * torque * share,
        "torque-speed-limit": torque * float(rng.uniform(0.6, 0.9)),
        "warming-friction": 0.08 * torque * share,
        "elastic-transmission": torque / (0.01 * travel * share),
        "loop-delay": 0.006 * share,
        "delay": 0.012 * share,
        "play": 0.012 * travel * share,
        "drive-gain": float(rng.choice([-1.0, 1.0])) * 0.4 * min(share, 1.2),
        "drive-play": 0.03 * travel * share,
        "gravity-compensation": min(share, 1.0),
        "dynamics-feedforward": min(share, 1.0),
        "integral-term": 0.6 * share,
        "motion-profile": 0.8 * share,
        "torque-limit": torque * float(rng.uniform(0.5, 0.9)),
        "asymmetric-damping": float(rng.choice([-1.0, 1.0])) * 0.05 * torque * share / max(rate, 1e-6),
        "constant-force": float(rng.choice([-1.0, 1.0])) * 0.08 * torque * share,
    }[effect]


def draw_shape(rng: np.random.Generator) -> dict[str, Any]:
    """Return the numbers of a form that are no sizes."""
    return {
        "free": float(rng.uniform(1.1, 1.8)),
        "backward": float(rng.uniform(1.8, 3.0)),
        "periods": float(rng.integers(8, 25)),
        "phase": float(rng.uniform(0, 2 * np.pi)),
        "warm_s": float(rng.uniform(10.0, 25.0)),
        "damper": float(rng.uniform(0.02, 0.1)),
        "ramp_s": float(rng.uniform(0.1, 0.4)),
    }
