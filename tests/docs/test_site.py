"""The site builds without a warning, needs no network to read, and its tables of keys are those of the models."""

import importlib
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from pydantic import BaseModel

import labrun
from labrun.experiment import Experiment, key_reference

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


API = r"^<!-- api: ([\w.]+)"
"""A module of the reference, as the pages of docs/api name it."""


def _hook(name):
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / "hooks" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _keys():
    return _hook("keys")


def _models_within(model: type[BaseModel], results: set[type[BaseModel]]) -> set[type[BaseModel]]:
    """Return a model and all models that its fields hold."""
    if model in results:
        return results
    results.add(model)
    waiting = [field.annotation for field in model.model_fields.values()]
    while waiting:
        item = waiting.pop()
        if isinstance(item, type) and issubclass(item, BaseModel):
            _models_within(item, results)
        waiting += getattr(item, "__args__", ())
    return results


def test_every_table_of_the_file_is_explained_key_by_key():
    keys, page = _keys(), (DOCS / "keys.md").read_text(encoding="utf-8")
    shown = re.findall(r"<!-- keys: ([\w.:]+) -->", page)
    for name in shown:
        table = keys.table(name)
        model = key_reference.model_of(name)
        assert len(table.splitlines()) == 2 + len(model.model_fields), name
    in_prose = {"Range", "Interval", "PluginTable", "SceneTable", "TakenFrom"}
    tables = {model.__name__ for model in _models_within(Experiment, set())}
    assert tables - in_prose <= {name.rpartition(":")[2] for name in shown}


def test_the_page_of_keys_is_what_the_models_make_of_it():
    keys = _keys()
    text = keys.PAGE.read_text(encoding="utf-8")
    assert keys.page(text) == text, "python docs/hooks/keys.py writes it again"


def test_a_key_without_a_word_is_an_error(monkeypatch):
    keys = _keys()
    monkeypatch.delitem(key_reference.WORDS["TrialTable"], "cycles")
    with pytest.raises(ValueError, match=r"TrialTable.*cycles"):
        keys.table("TrialTable")


def test_a_word_without_its_key_is_an_error(monkeypatch):
    keys = _keys()
    monkeypatch.setitem(key_reference.WORDS["TrialTable"], "cycle_count", "gone")
    with pytest.raises(ValueError, match=r"TrialTable.*cycle_count"):
        keys.table("TrialTable")


def test_every_module_of_the_reference_is_there():
    names = [
        name
        for page in (DOCS / "api").glob("*.md")
        for name in re.findall(API, page.read_text(encoding="utf-8"), re.M)
    ]
    assert len(names) > 40
    for name in names:
        assert importlib.import_module(name).__doc__, f"{name} has no docstring"


def test_every_function_of_the_api_has_its_line_and_its_place_in_the_reference():
    functions = {name for name in dir(labrun) if not name.startswith("_")}
    lines = re.findall(r"^\| `labrun.*", (DOCS / "api" / "index.md").read_text(encoding="utf-8"), re.M)
    assert {name for line in lines for name in re.findall(r"`labrun\.(\w+)\(", line)} == functions
    reference = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md"))
    modules = set(re.findall(API, reference, re.M))
    assert {f"labrun.app.{module}" for module in labrun._USE_CASES.values()} <= modules


def test_every_file_that_the_rules_for_contributors_name_is_there():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r"`((?:labrun|docs|tests|plugins)/[\w./-]+)`", text)
    assert named
    assert not [name for name in named if not (ROOT / name).exists()]


def test_the_reference_in_the_repository_is_what_the_docstrings_make_of_it():
    api = _hook("api")
    outdated = [page.name for page in api.PAGES.glob("*.md") if api.page(text := page.read_text()) != text]
    assert not outdated, "python docs/hooks/api.py writes them anew"


def test_on_the_site_the_whole_reference_stands_in_place_of_a_table():
    api = _hook("api")
    text = "# x\n\n<!-- api: labrun.app.open open OpenRun -->\n## `labrun.app.open`\n\n| | |\n<!-- /api -->\n\nend\n"
    shown = api.on_page_markdown(text)
    assert shown == "# x\n\n::: labrun.app.open\n    options:\n      members: [open, OpenRun]\n\n\nend\n"


def test_every_device_has_its_line_in_the_index_and_its_page_on_the_site():
    devices, index = _hook("devices"), (DOCS / "devices.md").read_text(encoding="utf-8")
    linked = {(DOCS / link).resolve() for link in re.findall(r"\]\((\S+/README\.md)\)", index)}
    assert linked == {path.resolve() for path in devices.readmes().values()}
    config = SimpleNamespace(nav=["index.md", {"Your hardware": ["safety.md", {"Devices": "devices/*"}]}])
    _, section = devices.on_config(config).nav
    assert section["Your hardware"][1]["Devices"] == [
        "devices.md",
        *(f"devices/{name}.md" for name in devices.readmes()),
    ]


@pytest.mark.parametrize("page", ["recordings.md", "examples/fish.md"])
def test_a_link_to_a_readme_leads_to_the_page_of_the_device_on_the_site(page):
    up = "../" * (page.count("/") + 1)
    link = f"see [it]({up}plugins/labrun_plugins/ati_daq/README.md#wiring)"
    shown = _hook("devices").on_page_markdown(link, SimpleNamespace(file=SimpleNamespace(src_uri=page)))
    assert (Path(page).parent / re.search(r"\((.*)#", shown)[1]).resolve() == Path(
        "devices/ati-daq.md"
    ).resolve()


def test_links_between_pages_lead_somewhere_in_the_repository():
    for page in [*DOCS.rglob("*.md"), ROOT / "README.md"]:
        for link in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), f"{page.relative_to(ROOT)}: {link}"


@pytest.mark.slow
def test_the_site_builds_strictly_and_fetches_nothing(tmp_path):
    pytest.importorskip("material")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    assert "WARNING" not in built.stderr
    for page in tmp_path.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        fetched = re.findall(
            r'<(?:script|img|iframe)[^>]* src="(https?:[^"]*)"|<link[^>]* href="(https?:[^"]*)"', text
        )
        assert not fetched, page.name
    assert (tmp_path / "search" / "search_index.js").is_file()
