"""Three tests of one mounting differ as Table 3.2 says."""

import numpy as np
import pytest
from labrun_plugins.rigs.hinge.scene import HingeBench

import labrun
from labrun.devices import Trajectory
from labrun.experiment import shipped_experiments
from labrun.store import read_recording

SPECIMEN = {
    "stiffness_n_m_rad": 0.0686,
    "damping_n_m_s_rad": 2.886e-4,
    "between_tests": [0.023, 0.032],
}


def released(seed, tests, **settings):
    """Return stiffness and damping (n, 2) of one release in each test."""
    bench = HingeBench({**SPECIMEN, **settings}, np.random.default_rng(seed))
    results = []
    for number, test in enumerate(tests):
        bench.arrange({"test": test})
        held = Trajectory(("hinge",), np.array([0.0, 0.5]), np.full((2, 1), 0.3))
        bench.drive("hinge", held, float(number))
        bench.observe(("hinge",), np.array([number + 0.2, number + 0.8]))
        release = bench.truth()["releases"][-1]
        results.append([release["stiffness"], release["damping"]])
    return np.array(results)


def test_tests_scatter_as_the_source_prints_and_releases_of_one_test_hardly():
    table = read_recording(shipped_experiments() / "recordings" / "table-3-2")
    printed = np.array([trial.outputs[0] for trial in table.trials])
    sd = printed.std(axis=0, ddof=1)
    many = released(1, range(400))
    assert many.mean(axis=0)[0] == pytest.approx(printed.mean(axis=0)[0], rel=0.005)
    assert many.std(axis=0, ddof=1)[0] == pytest.approx(sd[0], rel=0.1)
    relative = many.std(axis=0, ddof=1)[1] / many.mean(axis=0)[1]
    assert relative == pytest.approx(sd[1] / printed.mean(axis=0)[1], rel=0.1)
    alike = released(1, [1] * 50)
    assert np.all(alike.std(axis=0) / alike.mean(axis=0) < [0.002, 0.008])


def test_without_noise_every_test_is_the_same():
    assert np.ptp(released(1, range(5), noise=0), axis=0) == pytest.approx([0, 0])


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 5))])
def test_the_fit_tells_stiffness_and_damping_of_every_test(seed, tmp_path):
    run = labrun.run("hinge-repeatability", dry_run=True, seed=seed, results=tmp_path).run
    result = labrun.fit(run)
    table = result.tables[0]
    assert [row[0] for row in table.rows] == ["1", "2", "3", "mean", "standard deviation", "of the mean"]
    low, high = result.parameters["stiffness"].ci95
    assert low < 0.0686 < high
    assert result.parameters["stiffness"].value == pytest.approx(0.0686, rel=0.06)
    assert result.parameters["damping"].value == pytest.approx(2.886e-4, rel=0.08)


def test_a_shipped_recording_is_known_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    comparison = labrun.compare("table-3-2", tolerance="5%").comparison
    assert comparison.within
    assert comparison.worst.channel == "damping"
