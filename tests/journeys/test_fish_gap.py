"""What the fish's tank may hide is found from the run of an experiment that ships, without being told."""

import pytest


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "message"),
    [
        ("mean-current@fish:coefficient=2.7,speed=0.1", "mean-current at fish"),
        ("added-mass@fish:mass=0.5", "added-mass at fish"),
        ("drag-error@fish:coefficient=0.7", "drag-error at fish"),
    ],
)
def test_a_hidden_current_added_mass_and_drag_error_are_found_from_body_drag(hidden, message, labrun):
    ran = labrun("sweep", "body-drag", "--dry-run", "--seed", "6", "--hide", hidden)
    assert ran.code == 0, ran.err
    text = labrun("gap", "diagnose", "body-drag")
    assert text.code == 0, text.err
    opened = labrun("gap", "reveal", "body-drag")
    assert opened.code == 0, opened.err
    assert f"hidden    {message}" in opened.out
    assert "score     right" in opened.out, text.out


@pytest.mark.slow
def test_a_tank_that_hides_nothing_has_no_gap(labrun):
    assert labrun("sweep", "body-drag", "--dry-run", "--seed", "6", "--hide", "none").code == 0
    assert "No gap beyond noise" in labrun("gap", "diagnose", "body-drag").out
