"""Designs as controller tables of an experiment of kind track."""

from collections.abc import Sequence
from typing import Any

from labrun.fit.transfer import TransferFunction
from labrun.fit.tuning.design import Design

_DIGITS = 5


def controllers_toml(
    designs: Sequence[Design], best: str | None, i_per: str, loop_name: str, heading: str
) -> str:
    """Return tables ``[track.loops.NAME.controllers.DESIGN]``, ready to be pasted.

    Designs only: what was given stands in an experiment already, and what is unstable should stand in none.

    Parameters
    ----------
    best
        Name of the design that is recommended; it comes first.
    i_per
        ``"second"`` or ``"sample"``.
    loop_name
        The loop's name in the experiment.
    heading
        Comment above them.
    """
    import tomli_w

    lines = [f"# {line}".rstrip() for line in heading.splitlines()]
    stable = [one for one in designs if one.margins.stable and one.source != "given"]
    for design in sorted(stable, key=lambda one: one.name != best):
        found = design.margins
        phase = f"phase margin {found.phase_deg:.0f} deg" if found.phase_deg < 1e3 else "loop gain below 1"
        head = "recommended: " if design.name == best else ""
        lines += ["", f"# {head}{design.structure}, gain margin {found.gain:.2f}, {phase}"]
        nested = {"controllers": {design.name: controller_table(design, i_per)}}
        lines.append(tomli_w.dumps({"track": {"loops": {loop_name: nested}}}).rstrip())
    return "\n".join(lines) + "\n"


def controller_table(design: Design, i_per: str) -> dict[str, Any]:
    """Return the keys of a design's controller table."""
    gains = design.gains
    model = None if gains.feedforward is None else model_keys(design.loop.plant)
    keys = gains.settings(design.loop.step_s, i_per, model)
    return {"plugin": gains.plugin, **{key: _rounded(value) for key, value in keys.items()}}


def model_keys(plant: TransferFunction) -> dict[str, Any]:
    """Return the keys of a controller's model: gain, lag and dead time, or coefficients."""
    if plant.is_first_order:
        keys: dict[str, Any] = {"gain": plant.gain, "lag_s": plant.lag_s}
    else:
        keys = {"numerator": list(plant.numerator), "denominator": list(plant.denominator)}
    return keys | {"dead_s": plant.dead_s}


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, int | float) else value
