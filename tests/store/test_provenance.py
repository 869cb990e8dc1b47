"""Provenance tells what computed, on what machine, from which state of the workspace."""

import json
import subprocess

from labrun.devices import Identity
from labrun.store.journal import collect, git_state


def test_versions_machine_devices_and_seed_are_told_as_json(tmp_path):
    loads = json.loads(
        json.dumps(collect(tmp_path, seed=5, devices={"wrench": Identity("FT 300", serial="S1")}))
    )
    assert loads["seed"] == 5
    assert loads["devices"]["wrench"]["serial"] == "S1"
    assert {"python", "labrun", "numpy", "h5py"} <= set(loads["versions"])
    assert loads["machine"]["processors"] >= 1


def test_a_workspace_without_git_has_no_git_state(tmp_path, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert git_state(tmp_path) is None


def test_the_git_state_tells_commit_and_changes(tmp_path):
    def git(*arguments):
        identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
        return subprocess.run(
            ["git", "-C", str(tmp_path), *identity, *arguments], check=True, capture_output=True, text=True
        ).stdout

    git("init")
    (tmp_path / "fin.toml").write_text("a = 1\n")
    git("add", ".")
    git("commit", "-m", "first")
    clean = git_state(tmp_path)
    assert clean == {"commit": git("rev-parse", "HEAD").strip(), "changed_files": 0}
    (tmp_path / "fin.toml").write_text("a = 2\n")
    assert git_state(tmp_path)["changed_files"] == 1
