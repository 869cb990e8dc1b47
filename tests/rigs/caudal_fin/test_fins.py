"""Tails of other materials push as Table 5.2 says."""

import numpy as np
import pytest
from labrun_plugins.rigs.caudal_fin.fins import thrust_n
from labrun_plugins.rigs.caudal_fin.scene import CaudalTank
from simulated_bench import sine

from labrun.errors import SpecError
from labrun.experiment import shipped_experiments
from labrun.models import load_model, simulate
from labrun.store import read_recording

TABLE = read_recording(shipped_experiments() / "recordings" / "table-5-2").trials
FORCES = ["force_x", "force_y"]


def fins():
    return [
        pytest.param(trial.condition, float(trial.outputs[0, 0]), id=trial.source_file.stem)
        for trial in TABLE
    ]


@pytest.mark.parametrize(("fin", "printed_n"), fins())
def test_the_tank_gives_every_row_of_the_table(fin, printed_n):
    tank = CaudalTank({"noise": 0}, np.random.default_rng(0))
    tank.observe(FORCES, np.array([0.0]))
    tank.arrange(fin)
    assert tank.truth()["fin"] == fin
    tank.drive("tail", sine("tail", 60.0, 1.4, 14 / 1.4), 1.0)
    time_s = 1.0 + np.arange(6 / 1.4, 14 / 1.4, 0.01)
    forward, side = tank.observe(FORCES, time_s).mean(axis=0)
    assert forward == pytest.approx(printed_n, rel=0.05)
    assert side == pytest.approx(0.0, abs=0.02 * printed_n)


@pytest.mark.parametrize(("fin", "printed_n"), fins())
def test_the_model_file_knows_every_tail_of_the_table(fin, printed_n):
    time_s = np.arange(0.0, 4.0, 0.01)
    tail = np.radians(60.0) * np.sin(2 * np.pi * 1.4 * time_s)[:, None]
    pushed = [
        simulate(
            load_model("caudal-thrust"), time_s, tail, parameters={"entrained": 0.0}, condition=fin_settings
        ).outputs
        for fin_settings in (fin, {})
    ]
    share = pushed[0][-100:, 0] / pushed[1][-100:, 0]
    np.testing.assert_allclose(share, printed_n / 0.551, rtol=1e-6)


def test_stiffer_and_larger_tails_push_harder():
    thick = np.linspace(0.254, 1.524, 30)
    large = [thrust_n("polyester", mm, "large") for mm in thick]
    assert np.all(np.diff(large) > 0)
    assert all(thrust_n("polyester", mm, "small") < other for mm, other in zip(thick, large, strict=True))


@pytest.mark.parametrize(
    ("fin", "message"),
    [
        (("polyester", 3.0, "large"), "beyond Table 5.2"),
        (("acrylic", 1.0, "small"), "one acrylic tail"),
        (("steel", 1.0, "small"), "no fin of 'steel'"),
        (("polyester", 1.0, "huge"), "no 'huge' fin"),
    ],
)
def test_a_tail_that_the_table_does_not_reach_is_refused(fin, message):
    with pytest.raises(SpecError, match=message):
        thrust_n(*fin)


def test_a_tank_put_back_goes_on_with_the_same_tail():
    def made():
        tank = CaudalTank({}, np.random.default_rng(3))
        tank.observe(FORCES, np.array([0.0]))
        return tank

    tank, other = made(), made()
    tank.arrange({"material": "polyester", "thickness_mm": 0.254, "fin": "small"})
    tank.drive("tail", sine("tail", 60.0, 1.4, 5.0), 0.5)
    tank.observe(FORCES, np.array([2.0]))
    other.restore(tank.snapshot())
    time_s = np.arange(2.1, 4.0, 0.05)
    np.testing.assert_array_equal(tank.observe(FORCES, time_s), other.observe(FORCES, time_s))
