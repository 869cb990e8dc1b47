"""The experiment on the drag of the fish's body, held against a tow without end in the same tank."""

import numpy as np
import pytest
from labrun_plugins.rigs.fish.scene import FireTank

import labrun


def steady_drag_n(speed_m_s):
    """Drag after 4.5 m of the way, where nothing remembers its beginning."""
    tank = FireTank({"noise": 0}, np.random.default_rng(0))
    tank.observe(["force_x"], np.array([0.0]))
    tank.tow(0.0, 6.0, speed_m_s, 1.0, 1.0)
    time_s = np.arange(1.0 + 4.5 / speed_m_s, 1.0 + 6.0 / speed_m_s, 0.01)
    tank.observe(["force_x"], np.arange(0.5, time_s[0], 0.5))
    return -float(tank.observe(["force_x"], time_s).mean())


@pytest.mark.slow
def test_the_quadratic_drag_of_the_experiment_is_that_of_the_scene_within_3_percent(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = labrun.run("body-drag", dry_run=True, seed=1)
    trials = labrun.open(result.run).trials
    speed = trials["v"].to_numpy(dtype=float)
    measured = float((trials["drag"] * speed**2).sum() / (speed**4).sum())
    speeds = np.unique(speed)
    steady = float(np.sum([steady_drag_n(v) * v**2 for v in speeds]) / (speeds**4).sum())
    assert measured == pytest.approx(steady, rel=0.03)
