"""Where experiments are found, and how a workspace is made."""

import pytest

from labrun.errors import RequestError
from labrun.experiment import (
    create_workspace,
    find_experiment,
    find_model_file,
    list_experiments,
    shipped_experiments,
)
from labrun.store.recording import read_recording

SHIPPED = {"fin-modulation", "fin-params", "fin-step", "hinge", "turn-torque", "turn-torque-current"}


def test_the_shipped_experiments_are_found_from_an_empty_folder(tmp_path):
    assert {path.stem for path in list_experiments(tmp_path)} >= SHIPPED
    assert find_experiment("hinge", tmp_path) == shipped_experiments() / "hinge.toml"


def test_the_workspace_comes_before_what_is_shipped(tmp_path, good):
    (tmp_path / "experiments").mkdir()
    own = tmp_path / "experiments" / "hinge.toml"
    (tmp_path / "hinge.toml").write_text(good)
    assert find_experiment("hinge", tmp_path) == tmp_path / "hinge.toml"
    own.write_text(good)
    assert find_experiment("hinge", tmp_path) == own
    assert [path for path in list_experiments(tmp_path) if path.stem == "hinge"] == [own]


def test_a_path_is_taken_as_it_is(tmp_path, good):
    path = tmp_path / "anywhere" / "x.toml"
    path.parent.mkdir()
    path.write_text(good)
    assert find_experiment(str(path), tmp_path) == path
    assert find_experiment("anywhere/x.toml", tmp_path) == path


def test_a_misspelt_name_comes_with_the_nearest(tmp_path):
    with pytest.raises(RequestError, match='did you mean "fin-params"'):
        find_experiment("fin-param", tmp_path)


def test_other_toml_files_are_no_experiments(tmp_path):
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'x'\n")
    assert "pyproject" not in {path.stem for path in list_experiments(tmp_path)}


def test_a_model_is_no_experiment_though_its_sites_have_a_kind(tmp_path):
    model = shipped_experiments() / "models" / "hinge-pendulum.toml"
    assert "\nkind" in model.read_text()
    (tmp_path / "pendulum.toml").write_text(model.read_text())
    assert "pendulum" not in {path.stem for path in list_experiments(tmp_path)}


def test_a_broken_experiment_is_still_listed(tmp_path):
    (tmp_path / "mine.toml").write_text('kind = "run"\n[rig\n')
    assert "mine" in {path.stem for path in list_experiments(tmp_path)}


def test_a_new_workspace_has_the_shipped_experiments_and_their_models(tmp_path):
    written, left = create_workspace(tmp_path / "bench")
    assert not left
    names = {path.relative_to(tmp_path / "bench").as_posix() for path in written}
    assert {f"experiments/{name}.toml" for name in SHIPPED} <= names
    assert "experiments/models/hinge-pendulum.toml" in names
    assert "experiments/models/hinge-pendulum.xml" in names
    assert find_experiment("hinge", tmp_path / "bench") == tmp_path / "bench" / "experiments" / "hinge.toml"


def test_nothing_in_a_workspace_is_overwritten(tmp_path):
    create_workspace(tmp_path)
    own = tmp_path / "experiments" / "hinge.toml"
    own.write_text("# mine\n")
    (tmp_path / "experiments" / "fin-step.toml").unlink()
    written, left = create_workspace(tmp_path)
    assert written == [tmp_path / "experiments" / "fin-step.toml"]
    assert own in left
    assert own.read_text() == "# mine\n"


def test_a_workspace_that_cannot_be_made_is_a_request_gone_wrong(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RequestError, match="cannot be made"):
        create_workspace(tmp_path / "file" / "bench")


def test_a_model_is_found_beside_its_experiment_or_among_the_shipped(tmp_path):
    name = "models/hinge-pendulum.toml"
    assert find_model_file(name, None, tmp_path) == shipped_experiments() / name
    create_workspace(tmp_path)
    assert find_model_file(name, None, tmp_path) == tmp_path / "experiments" / name
    assert find_model_file("models/none.toml", None, tmp_path) is None


def test_a_models_name_means_the_workspaces_own_copy_and_a_plugins_or_shipped_one_only_without_it(tmp_path):
    assert find_model_file("hinge-pendulum", None, tmp_path) is None
    create_workspace(tmp_path)
    own = tmp_path / "experiments" / "models" / "hinge-pendulum.toml"
    assert find_model_file("hinge-pendulum", None, tmp_path) == own
    assert find_model_file("plugin:model", None, tmp_path) is None


def test_a_recording_of_a_new_workspace_can_be_read(tmp_path):
    create_workspace(tmp_path)
    recording = read_recording(tmp_path / "experiments" / "recordings" / "table-7-2")
    assert recording.trials
