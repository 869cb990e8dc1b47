"""Experiments at a glance, and a workspace of one's own."""

import json
import tomllib
from pathlib import Path

from forked_labrun import run_labrun


def test_list_shows_the_shipped_experiments_by_kind(tmp_path):
    experiments = json.loads(run_labrun("list", "--json", cwd=tmp_path).stdout)["experiments"]
    kinds = {item["name"]: item["kind"] for item in experiments}
    shipped = Path(__file__).parents[2] / "experiments"
    assert kinds == {path.stem: tomllib.loads(path.read_text())["kind"] for path in shipped.glob("*.toml")}
    assert {"run", "sweep", "cmaes", "track", "design"} == set(kinds.values())


def test_init_writes_the_shipped_experiments_and_leaves_what_is_there(tmp_path):
    mine = tmp_path / "bench" / "experiments" / "hinge.toml"
    mine.parent.mkdir(parents=True)
    mine.write_text('title = "mine"\nkind = "run"\n')
    written = json.loads(run_labrun("init", "bench", "--json", cwd=tmp_path).stdout)["written"]
    assert mine.read_text() == 'title = "mine"\nkind = "run"\n'
    assert any(path.endswith("fin-params.toml") for path in written)
    listed = json.loads(run_labrun("list", "--json", cwd=tmp_path / "bench").stdout)["experiments"]
    titles = {item["name"]: item["title"] for item in listed}
    assert titles["hinge"] == "mine"


def test_plugins_are_listed_with_their_origin(tmp_path):
    plugins = json.loads(run_labrun("plugins", "--json", cwd=tmp_path).stdout)["plugins"]
    assert {item["group"] for item in plugins} >= {
        "labrun.devices",
        "labrun.gaits",
        "labrun.objectives",
        "labrun.scenes",
    }
    assert all(item["origin"].startswith("labrun ") and not item["cause"] for item in plugins)


def test_doctor_reports_clock_disk_ports_and_plugins(tmp_path):
    findings = json.loads(run_labrun("doctor", "--json", cwd=tmp_path).stdout)["findings"]
    assert {"clock", "disk", "plugins"} <= {item["subject"] for item in findings}


def test_a_workspace_made_where_one_is_needs_no_change_of_folder(tmp_path):
    assert run_labrun("init", cwd=tmp_path).stdout.endswith("next:  labrun list\n")
    assert run_labrun("init", "bench", cwd=tmp_path).stdout.endswith("next:  cd bench && labrun list\n")
