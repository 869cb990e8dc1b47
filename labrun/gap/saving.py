"""The corrected model as a file that is usable wherever a model is named."""

from pathlib import Path

from labrun.errors import RequestError
from labrun.gap.diagnosis import Diagnosis

_ONLY = "Recalibrated only: the cause is not in the library. By labrun"


def save_model(diagnosis: Diagnosis, source: str | Path, path: Path) -> None:
    """Write the model with its corrected parameters and with the causes at their sites.

    Parameters
    ----------
    source
        Where the model comes from: what `labrun.models.load_model` took.
    path
        The file to write; one that is there is not overwritten.

    Raises
    ------
    RequestError
        The file is there already.
    ModelError
        A value that the model does not allow.
    """
    from labrun.models import corrected_model_text, load_model

    if path.exists():
        raise RequestError(f"{path} is there already", hint="name another file, or move that one away")
    model = load_model(source)
    text = corrected_model_text(
        model,
        source,
        diagnosis.corrected,
        diagnosis.effects,
        _remarks(diagnosis),
        folder=path.parent,
        heading=_ONLY if recalibrated_only(diagnosis) else "Corrected by labrun",
    )
    path.write_text(text, encoding="utf-8")


def recalibrated_only(diagnosis: Diagnosis) -> bool:
    """Tell whether a gap remains that nothing corrects: parameters then imitate what is missing."""
    return diagnosis.verdict == "not-in-library"


def _remarks(diagnosis: Diagnosis) -> list[str]:
    data = f"a diagnosis of {diagnosis.name}: {diagnosis.trials} trials, {diagnosis.conditions} conditions."
    if recalibrated_only(diagnosis):
        return [
            f"By {data}",
            diagnosis.sentence,
            "Its parameters imitate what is missing, as far as they can on these data: do not rely on them elsewhere.",
        ]
    found = [f"Corrected by {data}", diagnosis.sentence]
    for cause in diagnosis.causes:
        for name, one in cause.values.items():
            found.append(f"{cause.name}: {name} = {one.value:.5g} [{one.low:.5g}, {one.high:.5g}] {one.unit}")
    return found
