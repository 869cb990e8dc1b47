"""A table without repeats says how far its values may be off: what is beyond that is a gap, what is within is none."""

from pathlib import Path

import pytest

from labrun.app.question import ask
from labrun.gap.diagnose import Options, diagnose_dataset

FREQUENCIES_HZ = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
OFF = (0.4, -0.7, 0.9, -0.5, 0.2, -0.3)
"""By how many reading errors of 10 mN m the values are off."""
MODEL = """
name = "peak"
[parameters]
drag = { value = 0.1, tolerance = 0.02, unit = "N m s^2" }
[outputs]
torque = { equation = "drag*frequency_hz^2", unit = "N m" }
"""


def table(folder: Path, *, reading_error: str, most_n_m: float = 9.9) -> Path:
    folder.mkdir()
    (folder / "model.toml").write_text(MODEL)
    toml = ["[channels.torque]", 'kind = "output"', 'unit = "N m"', reading_error]
    for hz, off in zip(FREQUENCIES_HZ, OFF, strict=True):
        (folder / f"{hz}.csv").write_text(f"time_s,torque\n0,{min(0.1 * hz**2, most_n_m) + 0.01 * off}\n")
        toml += ["[[trials]]", f'file = "{hz}.csv"', f"condition = {{ frequency_hz = {hz} }}"]
    (folder / "recording.toml").write_text("\n".join(toml))
    return folder


def diagnosed(folder: Path):
    asked = ask(folder, None)
    return diagnose_dataset(asked.dataset, asked.model, Options(places=False))


def test_values_within_their_reading_error_are_no_gap(tmp_path: Path) -> None:
    result = diagnosed(table(tmp_path / "peak", reading_error="reading_error = 0.01"))
    assert result.verdict == "no-gap"
    assert result.noise["torque"] == 0.01


def test_a_limit_far_beyond_the_reading_error_is_named_with_its_level(tmp_path: Path) -> None:
    result = diagnosed(table(tmp_path / "peak", reading_error="reading_error = 0.01", most_n_m=0.3))
    assert [str(cause.name) for cause in result.causes] == ["saturation at torque"]
    assert result.causes[0].values["level"].value == pytest.approx(0.3, abs=0.02)
    assert "the reading error that the recording states" in result.limitations[0]


def test_the_same_limit_is_noise_beside_a_reading_error_as_large_as_it(tmp_path: Path) -> None:
    result = diagnosed(table(tmp_path / "peak", reading_error="reading_error = 0.6", most_n_m=0.3))
    assert not result.causes


def test_the_published_torque_of_a_wing_lacks_a_limit_of_its_recovery_stroke() -> None:
    table_7_2 = Path(__file__).parents[2] / "experiments" / "recordings" / "table-7-2"
    result = diagnosed(table_7_2)
    assert str(result.causes[0].name) == "saturation at recovery_stroke"
    assert result.causes[0].values["level"].value == pytest.approx(0.13, abs=0.01)
