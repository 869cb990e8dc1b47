"""A rig is found by its folder, without an import and without an edit elsewhere."""

import sys

import pytest

from labrun import registry
from labrun.errors import PluginError

SCENE = "class Pond:\n    pass\n"


@pytest.fixture
def rigs(tmp_path, monkeypatch):
    """A package of rigs of another distribution, with one rig in it."""
    folder = tmp_path / "some_lab" / "rigs" / "pond"
    folder.mkdir(parents=True)
    for package in (folder.parents[1], folder.parent, folder):
        (package / "__init__.py").touch()
    (folder / "scene.py").write_text(SCENE)
    (folder / "rig.toml").write_text('[scenes]\npond = "scene:Pond"\n')
    info = tmp_path / "some_lab-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: some-lab\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text("[labrun.rigs]\nlab = some_lab.rigs\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    registry.read_again()
    yield folder
    registry.read_again()
    for name in [name for name in sys.modules if name.partition(".")[0] == "some_lab"]:
        del sys.modules[name]


def test_a_folder_with_a_rig_file_is_found_and_not_imported(rigs):
    (result,) = (entry for entry in registry.installed("labrun.scenes") if entry.name == "pond")
    assert (result.target, result.origin) == ("some_lab.rigs.pond.scene:Pond", "some-lab 1.2")
    assert "some_lab.rigs.pond" not in sys.modules
    assert registry.load("labrun.scenes", "pond").__name__ == "Pond"


def test_the_rigs_that_come_with_labrun_are_still_there(rigs):
    assert {"pond", "hinge-bench", "caudal-tank"} <= set(registry.names("labrun.scenes"))


def test_a_kind_that_does_not_exist_is_told_with_the_nearest_and_the_file(rigs):
    (rigs / "rig.toml").write_text('[scene]\npond = "scene:Pond"\n')
    with pytest.raises(PluginError, match=r"rig\.toml: a rig declares no 'scene'") as caught:
        registry.names("labrun.scenes")
    assert "did you mean [scenes]?" in str(caught.value.hint)


def test_a_rig_file_that_is_no_toml_is_named(rigs):
    (rigs / "rig.toml").write_text("[scenes\n")
    with pytest.raises(PluginError, match=r"rig\.toml cannot be read"):
        registry.names("labrun.scenes")
