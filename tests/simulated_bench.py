"""What the tests of devices and scenes share: a clock by hand, and gaits."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from labrun import registry
from labrun.devices import DeviceContext, Trajectory


class HandClock:
    poll_s = 0.1

    def __init__(self, now_s: float = 0.0) -> None:
        self.now_s = now_s

    def now(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        self.now_s += max(0.0, duration_s)


class StillScene:
    """Feels constant loads, sees a body at rest."""

    joints = ("tail",)

    def __init__(self, values: Mapping[str, float]) -> None:
        self.signals = dict.fromkeys(values, "N")
        self.values = dict(values)
        self.driven: list[tuple[str, Trajectory, float]] = []
        self.towed: list[tuple[float, float, float, float]] = []

    def drive(self, joint: str, trajectory: Trajectory, start_s: float) -> None:
        self.driven.append((joint, trajectory, start_s))

    def tow(self, from_m: float, to_m: float, speed_m_s: float, start_s: float) -> None:
        self.towed.append((from_m, to_m, speed_m_s, start_s))

    def observe(self, signals: Any, time_s: Any) -> Any:
        return np.tile([float(self.values[signal]) for signal in signals], (len(time_s), 1))


def device(
    plugin: str, name: str, settings: Mapping[str, Any], scene: Any, clock: HandClock, seed: int = 1
) -> Any:
    made = registry.load("labrun.devices", plugin)
    return made(name, made.Settings(**settings), DeviceContext(clock, np.random.default_rng(seed), scene))


def sine(
    joint: str, amplitude_deg: float, frequency_hz: float, duration_s: float, *, offset_deg: float = 0.0
) -> Trajectory:
    time_s = np.linspace(0.0, duration_s, round(100 * duration_s) + 1)
    angle = np.radians(offset_deg + amplitude_deg * np.sin(2 * np.pi * frequency_hz * time_s))
    return Trajectory((joint,), time_s, angle[:, None], 1 / frequency_hz)


def line(joint: str, points_deg: list[float], times_s: list[float]) -> Trajectory:
    return Trajectory((joint,), np.array(times_s), np.radians(points_deg)[:, None])
