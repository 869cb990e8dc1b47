"""What can be hidden in a joint: forms of their own, in another shape than the library's where there is one."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

EFFECTS = (
    "coulomb-friction", "stribeck-friction", "load-dependent-friction", "gear-efficiency", "cogging",
    "torque-speed-limit", "warming-friction", "elastic-transmission", "loop-delay", "delay", "play",
    "drive-gain",
)  # fmt: skip
"""By the name that a right answer gives."""


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

    def torque(self, t: float, goal: float, q: float, rate: float) -> float:
        """Return what drive and friction put on the link."""
        sizes = self.sizes
        if "delay" in sizes:
            goal = self._delayed("delay", goal, sizes["delay"])
        spring = sizes.get("elastic-transmission", 0.0)
        if spring:
            return self._elastic(goal, q, rate, spring)
        drive = self.kp * (goal - q) - self.kv * rate
        if "loop-delay" in sizes:
            drive = self._delayed("loop", drive, sizes["loop-delay"])
        drive *= 1.0 + sizes.get("drive-gain", 0.0)
        if "torque-speed-limit" in sizes:
            stall = sizes["torque-speed-limit"]
            free = self.shape["free"] * self.rate_scale
            upper, lower = stall * max(1.0 - rate / free, 0.0), -stall * max(1.0 + rate / free, 0.0)
            drive = min(max(drive, min(lower, 0.0)), max(upper, 0.0))
        out = drive
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

    def _elastic(self, goal: float, q: float, rate: float, spring: float) -> float:
        if self._motor is None:
            self._motor = [q, rate]
        # the midpoint rule, as the links: it asks at the beginning and in the middle of a step in turn. A motor that
        # only used where each half began was early by half of it, a quarter of a millisecond
        angle, speed = self._motor if self._middle is None else self._middle
        damper = self.shape["damper"] * np.sqrt(spring * self.armature)
        through = spring * (angle - q) + damper * (speed - rate)
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
        if self._motor is not None:
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


def draw_size(effect: str, rng: np.random.Generator, torque: float, travel: float) -> float:
    """Return a size that such joints have, SI."""
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
    }
