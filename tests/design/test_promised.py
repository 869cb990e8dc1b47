"""What a design promised beside what its rig gave: who names both says which is which."""

import pytest

import labrun
from labrun.app.design import design
from labrun.errors import RequestError


@pytest.fixture
def designed(paddle, tmp_path):
    """Return the run of a small design, and a table of what its rig gave: a tenth less."""
    path = paddle(("iterations = 25", "iterations = 3"))
    design(path, dry_run=True, seed=3, workers=1, draw=False)
    folder = tmp_path / "measured"
    folder.mkdir()
    best = labrun.open("paddle").trials.sort_values("distance").iloc[-1]
    condition = ", ".join(f"{name} = {float(best[name])!r}" for name in ("length", "stroke", "f"))
    (folder / "1.csv").write_text(f"time_s,distance\n0,{0.9 * best.distance}\n")
    (folder / "recording.toml").write_text(
        '[channels.distance]\nkind = "output"\nunit = "m"\n'
        f'[[trials]]\nfile = "1.csv"\ncondition = {{ {condition} }}\n'
    )
    return folder


def test_the_promise_is_held_against_the_rig_whichever_is_named_first(designed):
    there, back = (
        labrun.compare(first, other, tolerance="5%")
        for first, other in (("design:paddle", f"rig:{designed}"), (f"rig:{designed}", "design:paddle"))
    )
    assert (there.comparison.data, there.comparison.prediction) == ("measured", "paddle")
    assert there.comparison.worst.relative == pytest.approx(
        1 / 9, rel=0.05
    )  # copies of it differ within tolerances
    assert not there.within
    assert back.comparison.worst == there.comparison.worst


@pytest.mark.parametrize(
    ("first", "other", "message"),
    [
        ("design:paddle", "paddle", "expected one run of a design and one of a rig"),
        ("design:paddle", None, "expected one run of a design and one of a rig"),
        ("design:measured", "rig:paddle", "is not a design"),
    ],
)
def test_a_role_that_does_not_fit_is_told(designed, first, other, message):
    first = first.replace("measured", str(designed))
    with pytest.raises(RequestError, match=message):
        labrun.compare(first, other)
