"""The corrected model as a file that is usable wherever a model is named."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labrun.effects import AttachedEffect, load_effect, read_effects
from labrun.errors import RequestError
from labrun.gap.diagnosis import Diagnosis, Name
from labrun.models import corrected_model_text, load_model
from labrun.store import replace_durably, require_writable, saving


def effects_of(diagnosis: Mapping[str, Any]) -> tuple[AttachedEffect, ...]:
    """Return the causes of a diagnosis, as it is stored, as effects at their sites."""
    return tuple(
        AttachedEffect(load_effect(effect["effect"], effect["kind"]), effect["site"], tuple(effect["values"]))
        for effect in diagnosis["effects"]
    )


def save_model(diagnosis: Mapping[str, Any], source: str | Path, path: Path) -> None:
    """Write the model with its corrected parameters and with the causes at their sites.

    Parameters
    ----------
    diagnosis
        As `Diagnosis.to_json` gives it, and as it is stored.
    source
        Where the model comes from: what `labrun.models.load_model` took.
    path
        The file to write; one that is there is not overwritten.

    Raises
    ------
    RequestError
        The file is there already.
    StoreError
        It cannot be written.
    ModelError
        A value that the model does not allow.
    """
    require_new(path)
    effects = effects_of(diagnosis)
    only = recalibrated_only(diagnosis)
    text = corrected_model_text(
        load_model(source),
        source,
        diagnosis["corrected"],
        effects,
        _remarks(diagnosis),
        folder=path.parent,
        heading="Recalibrated only: the cause is not in the library. By labrun"
        if only
        else "Corrected by labrun",
        data=diagnosis["source"],
    )
    _write(path, text)


def save_with_law(diagnosis: Diagnosis, source: str | Path, law: Path, path: Path) -> None:
    """Write the law for the rest as a file of effects, and the model with it, the causes and all sizes refitted.

    Parameters
    ----------
    source
        Where the model comes from.
    law, path
        The files to write; those that are there are replaced.

    Raises
    ------
    StoreError
        A file cannot be written.
    ModelError
        A value that the model does not allow.
    """
    rest = diagnosis.law
    if rest is None or not rest.terms:
        return
    _write(law, f"# {rest.sentence}\n\n{rest.toml}")
    added = AttachedEffect(read_effects(law.resolve())[0], rest.site, rest.values)
    text = corrected_model_text(
        load_model(source),
        source,
        rest.corrected,
        (*rest.effects, added),
        [
            diagnosis.sentence,
            rest.sentence,
            "The law was found by regression: look for the physics that has its form.",
        ],
        folder=path.parent,
        heading="With a law for what the library lacks, by labrun",
        data=diagnosis.source,
    )
    _write(path, text)


def _write(path: Path, text: str) -> None:
    with saving(path.name, path.absolute().parent):
        replace_durably(path, text.encode())


def require_new(path: Path) -> None:
    """Refuse, before minutes of computing, a place where no new model can be written.

    Raises
    ------
    RequestError
        A file is there already, or no folder.
    StoreError
        Nothing can be written to the folder.
    """
    if path.is_dir():
        raise RequestError(f"{path} is a folder", hint="name a file, e.g. corrected.toml")
    if path.exists():
        raise RequestError(f"{path} is there already", hint="name another file, or move that one away")
    if not path.absolute().parent.is_dir():
        raise RequestError(f"cannot find the folder {path.parent} for the corrected model")
    require_writable(path.absolute().parent, path.name)


def recalibrated_only(diagnosis: Mapping[str, Any]) -> bool:
    """Tell whether a gap remains that nothing corrects: parameters then imitate what is missing."""
    return not diagnosis["causes"]


def _remarks(diagnosis: Mapping[str, Any]) -> list[str]:
    count = diagnosis["data"]
    data = f"a diagnosis of {diagnosis['name']}: {count['trials']} trials, {count['conditions']} conditions."
    if recalibrated_only(diagnosis):
        return [
            f"By {data}",
            diagnosis["sentence"],
            "Its parameters imitate what is missing, as far as they can on these data: do not rely on them elsewhere.",
        ]
    remarks = [f"Corrected by {data}", diagnosis["sentence"]]
    for cause in diagnosis["causes"]:
        name = Name(cause["effect"], cause["site"], cause["kind"])
        for key, value in cause["values"].items():
            low, high = value["ci95"]
            line = f"{name}: {key} = {value['value']:.5g} [{low:.5g}, {high:.5g}] {value['unit']}"
            remarks.append(line.removesuffix(" 1"))  # a ratio
    return remarks
