"""The entries of effects.md, made from the same TOML files as the effects, so that the page says what is simulated.

    python docs/hooks/effects_page.py

writes the entries and their pictures anew; the tests compare page and pictures with what is installed.
"""

import math
import sys
import textwrap
from pathlib import Path

from labrun.effects import Effect, EffectParameter, effects

DOCS = Path(__file__).parents[1]
PAGE = DOCS / "effects.md"
PICTURES = DOCS / "images" / "effects"
BEGIN, END = "<!-- effects: begin -->", "<!-- effects: end -->"
_WIDTH = 78
KINDS = {
    "joint": (
        "Joints",
        "The pendulum is driven for five seconds, then left to swing; where an effect needs the drive, a joint "
        "with a position servo follows a sine, then holds.",
    ),
    "base": ("Bases of robots", "The joint follows a sine for five seconds, then holds; its base is tilted."),
    "tip": (
        "Tips of robots",
        "The joint follows a sine for five seconds, then holds; a load hangs at its tip.",
    ),
    "link": (
        "Links of robots",
        "The joint follows a sine for five seconds, then holds; its link, on which gravity acts, gives way.",
    ),
    "controller": (
        "Controllers of robots",
        "The joint, on which gravity acts, follows a sine for five seconds, then holds; its controller adds a torque.",
    ),
    "body": ("Bodies in a fluid", "The body is pushed to and fro for five seconds, then left to glide."),
    "input": ("Inputs", "The signal is what a model is given: a sine, then steps."),
    "output": ("Outputs", "The signal is what a model puts out: a sine, then steps."),
}


def pictures() -> dict[str, Effect]:
    """Return every installed effect by the name of its picture."""
    return {f"{effect.kind}-{effect.id}.png": effect for effect in effects()}


def entries() -> str:
    """Return the entries of the page as Markdown, by kind of site."""
    parts = []
    for kind, (title, rig) in KINDS.items():
        parts += [f"## {title}", rig]
        for effect in sorted(
            (other for other in effects() if other.kind == kind), key=lambda effect_: effect_.id
        ):
            parts.append(entry(effect))
    return "\n\n".join(parts)


def entry(effect: Effect) -> str:
    """Return the entry of one effect: what it is, its equation, parameters, source and picture."""
    heading = f"### {effect.id}" + (f" ({effect.kind})" if effect.kind in ("input", "output") else "")
    needs = [f"the site's `{need}`" for need in effect.needs]
    if effect.signals > 1:
        needs.append(f"{effect.signals} {effect.kind}s")
    rows = "\n".join(_row(effect, parameter) for parameter in effect.parameters)
    article = "an" if effect.kind[0] in "aeiou" else "a"
    return "\n\n".join(
        [
            heading,
            effect.title + (f" Needs {' and '.join(needs)}." if needs else ""),
            "```text\n" + textwrap.fill(effect.form, _WIDTH, break_on_hyphens=False) + "\n```",
            "| parameter | unit | bounds | times typical | neutral | starts |\n|---|---|---|---|---|---|\n"
            + rows,
            f"Source: {effect.source}.",
            f"![{effect.id} at {article} {effect.kind} site: the output without it and at two sizes, and the change]"
            f"(images/effects/{effect.kind}-{effect.id}.png)",
        ]
    )


def page(text: str) -> str:
    """Return the page with its entries made anew."""
    head, rest = text.split(BEGIN)
    return f"{head}{BEGIN}\n\n{entries()}\n\n{END}{rest.split(END)[1]}"


def _row(effect: Effect, parameter: EffectParameter) -> str:
    bounds = f"{_number(parameter.lower)} to {_number(parameter.upper)}"
    neutral = "(shape)" if parameter.neutral is None else _number(parameter.neutral)
    starts = ", ".join(dict.fromkeys(_number(start) for start in parameter.starts))
    held = " (held)" if parameter.held else ""
    unit, typical = _unit(effect, parameter), _typical(parameter)
    return f"| `{parameter.name}` | {unit} | {bounds} | {typical} | {neutral} | {starts}{held} |"


def _unit(effect: Effect, parameter: EffectParameter) -> str:
    """Return the unit at a turning and at a straight site, or as that of the signal."""
    if effect.kind in ("input", "output"):
        return parameter.unit(signal_unit="signal").replace("signal", "the signal's")
    turning, straight = parameter.unit("rad"), parameter.unit("m")
    return turning if turning == straight else f"{turning} or {straight}"


def _typical(parameter: EffectParameter) -> str:
    return "itself" if parameter.quantity == "ratio" else parameter.quantity.replace("-", " ")


def _number(value: float) -> str:
    text = ("\u221e" if value > 0 else "-\u221e") if math.isinf(value) else f"{value:g}"
    return text.replace("-", "\N{MINUS SIGN}")


if __name__ == "__main__":
    from effect_signatures import write_pictures

    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    write_pictures(pictures(), PICTURES)
    sys.stdout.write(f"wrote {PAGE} and {len(pictures())} pictures\n")
