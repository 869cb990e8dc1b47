"""An effect plugin that does not import stops a diagnosis by its name, and can be left out by its name."""

import pytest

from labrun import registry
from labrun.effects import Scale, effects
from labrun.errors import PluginError, RequestError
from labrun.gap.candidates import candidates
from labrun.models import parse_model

SCALES = {("joint", "hinge"): Scale(), ("output", "q"): Scale()}


@pytest.fixture
def broken(tmp_path, monkeypatch):
    """Install a distribution whose effect `sticky-thing` names a module that is not there."""
    info = tmp_path / "broken_lab-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-lab\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[labrun.effects]\nsticky-thing = not_there_at_all:EFFECT\n")
    monkeypatch.syspath_prepend(tmp_path)
    registry.read_again()
    yield "sticky-thing"
    monkeypatch.undo()
    registry.read_again()


def model():
    return parse_model(
        'name = "m"\nstates = ["q", "v"]\n[equations]\nq = "v"\nv = "force.hinge - q"\n[outputs]\nq = "q"\n'
        '[sites.hinge]\nkind = "joint"\ncoordinate = "q"\nrate = "v"\n',
        "m.toml",
    )


def test_it_is_not_left_out_in_silence(broken):
    with pytest.raises(PluginError, match="'sticky-thing' of broken-lab cannot be imported"):
        candidates(model(), SCALES)


def test_withheld_by_name_it_is_not_imported_and_all_else_is_tried(broken):
    names = {candidate.name for candidate in candidates(model(), SCALES, (broken,))}
    assert {name.effect for name in names} <= {effect.id for effect in effects(without=(broken,))}
    assert {"coulomb-friction", "delay"} <= {name.effect for name in names}
    assert broken not in {name.effect for name in names}


def test_a_misspelt_name_is_refused_though_the_plugin_is_out(broken):
    with pytest.raises(RequestError, match="coulomb-frction"):
        candidates(model(), SCALES, (broken, "coulomb-frction"))


def test_withholding_a_plugin_that_works_takes_its_effects_and_no_others():
    every, fewer = ({effect.id for effect in effects(without=names)} for names in ((), ("delay",)))
    assert every - fewer == {"delay"}
