"""Where a run comes from, folded: software, machine, devices, and the experiment file."""

from collections.abc import Mapping
from typing import Any

from labrun.report.html_elements import Content, Html, element, folded, section, table
from labrun.report.report_source import ReportSource

_TOLD_APART = frozenset(
    {"experiment_text", "versions", "machine", "git", "devices", "command", "dry_run", "emulated"}
)


def provenance_section(source: ReportSource) -> Html:
    """Return where the run comes from."""
    provenance = source.run.provenance
    written = provenance.get("experiment_text")
    return section(
        "provenance",
        "Where this comes from",
        folded("Software, machine and devices", table(("", ""), _rows(provenance), words=(0, 1))),
        folded(
            "recording.toml" if source.imported else "Experiment file, resolved",
            element("pre", source.run.experiment_toml),
        ),
        folded("Experiment file, as it was written", element("pre", str(written))) if written else None,
    )


def _rows(provenance: Mapping[str, Any]) -> list[list[Content]]:
    rows: list[list[Content]] = [["seed", str(provenance["seed"])]] if "seed" in provenance else []
    if "dry_run" in provenance:
        emulated = "emulated (real drivers)" if provenance.get("emulated") else "hardware"
        rows.append(["bench", "simulated (dry run)" if provenance["dry_run"] else emulated])
    for name, device in _table(provenance.get("devices")).items():
        rows.append([f"device {name}", _device(device)])
    git = provenance.get("git")
    if git:
        changed = git.get("changed_files", 0)
        state = f"{changed} changed files" if changed else "no changes"
        rows.append(["git", f"{git.get('commit', '')}, {state}"])
    elif "git" in provenance:
        rows.append(["git", "the workspace was not under version control"])
    rows += [
        [f"{name} version", str(version)] for name, version in _table(provenance.get("versions")).items()
    ]
    rows += [[str(name), str(value)] for name, value in _table(provenance.get("machine")).items()]
    command = provenance.get("command")
    if isinstance(command, list):
        rows.append(["command", " ".join(str(word) for word in command)])
    rows += [
        [str(name).replace("_", " "), str(value)]
        for name, value in provenance.items()
        if name not in _TOLD_APART and name != "seed"
    ]
    return rows


def _device(device: Any) -> str:
    if not isinstance(device, Mapping):
        return str(device)
    known = [str(device.get("model", ""))]
    known += [f"{key} {device[key]}" for key in ("serial", "firmware") if device.get(key)]
    known += [f"{key} {value}" for key, value in _table(device.get("details")).items()]
    return ", ".join(part for part in known if part)


def _table(value: Any) -> Mapping[Any, Any]:
    return value if isinstance(value, Mapping) else {}
