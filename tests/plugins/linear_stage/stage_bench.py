"""What the tests of the stage share."""

import numpy as np

from labrun.devices import Trajectory

CELL = {"slope_n_per_count": 4.676e-6, "offset_counts": 21400, "residual_n": 0.004, "date": "2026-03-02"}
SETTINGS = {
    "port": "replaced by the emulator's",
    "zero_mm": 2,
    "home_on_open": True,
    "joints": {"bend": {"lever_mm": 100}},
    "calibration": CELL,
    "limits": {"travel_m": [-0.0015, 0.02], "speed_m_s": 0.008, "force_n": 7, "angle_deg": [-0.8, 11]},
}


def stage_settings(**changes):
    return {**SETTINGS, **changes}


def bend(points_rad, times_s):
    return Trajectory(("bend",), np.array(times_s, dtype=float), np.array(points_rad, dtype=float)[:, None])


def commands(bench, word=None, after_s=0.0):
    """Return the moves that the emulator has witnessed."""
    return [
        line for line in bench.events("command") if line["time_s"] >= after_s and word in (None, line["word"])
    ]
