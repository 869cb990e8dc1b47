"""effects.md says of every effect that is installed what its code says, and shows it."""

import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from labrun.effects import effects

DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS / "hooks"))

import effect_signatures  # noqa: E402
import effects_page as page  # noqa: E402

sys.path.remove(str(DOCS / "hooks"))

LARGEST_PICTURE = 25_000
EVERY = [pytest.param(effect, id=f"{effect.kind}-{effect.id}") for effect in effects()]


def test_the_page_is_what_the_installed_effects_make_of_it():
    text = page.PAGE.read_text(encoding="utf-8")
    assert page.page(text) == text, "python docs/hooks/effects_page.py writes it again"


def test_there_is_a_picture_for_every_effect_and_no_other():
    there = {file.name for file in page.PICTURES.iterdir()}
    assert there == set(page.pictures())


def test_pictures_are_small():
    sizes = {file.name: file.stat().st_size for file in page.PICTURES.iterdir()}
    assert max(sizes.values()) <= LARGEST_PICTURE, sizes


@pytest.mark.parametrize("effect", EVERY)
def test_an_effect_shows_in_its_picture_and_differently_at_its_two_sizes(effect):
    signature = effect_signatures.signature(effect)
    visible = 0.01 * np.ptp(signature.bare)
    first, second = signature.outputs
    for output in signature.outputs:
        assert np.abs(output - signature.bare).max() > visible
    assert np.abs(first - second).max() > visible


@pytest.mark.rendered
def test_a_picture_is_drawn_as_it_was_committed():
    """Of one effect of each kind: size and most of the pixels, as fonts may be another build's."""
    for name in ("joint-viscous-damping.png", "body-wall-echo.png", "input-delay.png", "output-drift.png"):
        drawn = page.PICTURES / name
        committed = np.asarray(Image.open(drawn).convert("L"), dtype=float)
        again = _decoded(effect_signatures.picture(page.pictures()[name]))
        assert again.shape == committed.shape
        assert np.mean(np.abs(again - committed) > 40) < 0.03, f"{name}: python docs/hooks/effects_page.py"


def _decoded(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(png)).convert("L"), dtype=float)
