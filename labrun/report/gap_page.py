"""The page of a diagnosis: the context of its template."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from labrun.experiment import condition_key
from labrun.gap import ComparedTrace, Diagnosis, MissingForce, RatedCandidate
from labrun.report import gap_words
from labrun.report.figures.gap import how_far_figure, where_figure
from labrun.report.figures.gap_traces import force_figure, shown_traces, traces_figure, worst_outputs
from labrun.report.gap_words import (
    HEADLINES,
    VERDICTS,
    hot_spots,
    place_words,
    ranked,
    status_words,
    times_noise,
    value_words,
)
from labrun.report.page import PageFigure, PageTable, drawn, render
from labrun.report.text import listed, number, percent, scatter_text, spaced, unit_text, with_unit

_SHOWN = 10
_MOST_FORCES = 2
_FAR = 3.0
"""Of more than so many stated tolerances a parameter is not just recalibrated, it was wrong."""
_ALT_WHERE = "Shares of the excess over the noise; the table below has all of them"
_ALT_FAR = "Gap as stated, recalibrated, with the causes, and the noise floor"


def diagnosis_page(diagnosis: Diagnosis) -> str:
    """Return the page of a diagnosis; the same diagnosis gives the same text, byte for byte."""
    return render("gap.html.j2", diagnosis_context(diagnosis))


def diagnosis_context(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the context of the template ``gap.html.j2``."""
    every = ranked(diagnosis.candidates)
    first = max(_SHOWN, sum(candidate.verdict in ("cause", "rival") for candidate in every))
    parameters = parameter_table(diagnosis)
    links = [
        ("ladder", "errors"), ("which", "causes"), ("rest", "the rest"), ("where", "where"),
        ("next", "what next" if diagnosis.what_next else ""),
        ("limits", "limitations" if diagnosis.limitations else ""),
        ("recalibration", "parameters" if parameters.rows else ""),
        ("data", "data and noise"), ("origin", "origin"),
    ]  # fmt: skip
    return {
        "title": f"{diagnosis.name} against {diagnosis.model}",
        "d": diagnosis,
        "words": gap_words,
        "headline": HEADLINES[diagnosis.verdict],
        "links": [(anchor, name) for anchor, name in links if name],
        "hot_spots": hot_spots(diagnosis.where),
        "where": drawn(lambda: where_figure(diagnosis), "where", _ALT_WHERE),
        "places": _places(diagnosis),
        "traces": _traces(diagnosis),
        "chosen_traces": _chosen(diagnosis, shown_traces(diagnosis)),
        "has_courses": any(len(trace.time_s) > 1 for trace in shown_traces(diagnosis)),
        "forces": [
            (force, result)
            for force in sorted(diagnosis.missing, key=lambda force: -force.share)[:_MOST_FORCES]
            if (result := _force(force)) is not None
        ],
        "tally": _tally(every),
        "candidates": [_candidate(candidate, rank) for rank, candidate in enumerate(every[:first], start=1)],
        "other_candidates": [
            _candidate(candidate, rank) for rank, candidate in enumerate(every[first:], start=first + 1)
        ],
        "how_far": drawn(lambda: how_far_figure(diagnosis), "far", _ALT_FAR),
        "ladder": _ladder(diagnosis),
        "parameters": parameters,
        "noise": _noise(diagnosis),
        "inputs": ", ".join(with_unit(spaced(name), unit) for name, unit in diagnosis.input_channels)
        or "none",
    }


def _ladder(diagnosis: Diagnosis) -> PageTable:
    """Return the error on unseen data as stated, recalibrated and with each cause in turn; a column per output."""
    outputs = [with_unit(spaced(name), unit) for name, unit in diagnosis.channels]
    rows = [
        [
            rung.step,
            *(number(rung.errors.get(name, math.nan), 3) for name, _ in diagnosis.channels),
            times_noise(rung.in_noise),
            "" if rung.cause is None else percent(rung.closes),
        ]
        for rung in diagnosis.ladder
    ]
    return PageTable(("model", *outputs, "times the noise", "closes of the gap"), rows, words=(0,))


def _places(diagnosis: Diagnosis) -> PageTable:
    rows = [
        [
            location.by,
            place_words(location),
            percent(location.share),
            "" if location.p is None else f"{location.p:.3g}",
        ]
        for location in diagnosis.where
    ]
    return PageTable(("by", "part", "share of the excess", "p"), rows, words=(0, 1))


def _traces(diagnosis: Diagnosis) -> PageFigure | None:
    return drawn(
        lambda: traces_figure(diagnosis), "traces", "Measured and simulated outputs where they differ most"
    )


def _chosen(diagnosis: Diagnosis, traces: Sequence[ComparedTrace]) -> str:
    """Return which conditions and outputs are shown, where it is not all of them."""
    if not traces:
        return ""
    conditions = len({condition_key(trace.condition) for trace in traces})
    outputs = len(worst_outputs(diagnosis, traces))
    messages = []
    if conditions < diagnosis.conditions:
        messages.append(f"{conditions} of {diagnosis.conditions} conditions")
    if outputs < len(diagnosis.channels):
        messages.append(f"{outputs} of {len(diagnosis.channels)} outputs")
    return listed(messages)


def _force(missing: MissingForce) -> PageFigure | None:
    return drawn(lambda: force_figure(missing), "force", f"What is missing at {missing.site}", points=True)


def _tally(every: Sequence[RatedCandidate]) -> str:
    counts = {verdict: sum(row.verdict == verdict for row in every) for verdict in VERDICTS}
    names = {
        "cause": "a cause" if counts["cause"] == 1 else "causes",
        "rival": "a rival" if counts["rival"] == 1 else "rivals",
        "not-needed": "not needed",
        "excluded": "excluded above a size",
        "not-visible": "not visible in these data",
    }
    parts = [
        f"{count} {'is' if count == 1 else 'are'} {names[verdict]}"
        for verdict, count in counts.items()
        if count
    ]
    if not counts["cause"]:
        parts.insert(0, "none is a cause")
    return f"Of {len(every)} candidates {listed(parts)}."


def _candidate(row: RatedCandidate, rank: int) -> Mapping[str, Any]:
    parts = value_words(row.values) if row.verdict == "cause" else []
    return {
        "rank": rank,
        "name": row.name.words,
        "is_cause": row.verdict == "cause",
        "verdict": status_words(row),
        "closes": row.closes,
        "size": "; ".join([*parts, row.remark] if row.remark else parts),
    }


def parameter_table(diagnosis: Diagnosis) -> PageTable:
    """Return the parameters as stated and as recalibrated; without rows of a model without any that may move."""
    rows, marked = [], []
    for index, (name, (stated, tolerance, fitted)) in enumerate(diagnosis.recalibration.items()):
        text, far = _moved(stated, tolerance, fitted)
        if far:
            marked.append(index)
        corrected = number(diagnosis.corrected[name], 4) if name in diagnosis.corrected else ""
        unit = unit_text(diagnosis.parameter_units.get(name, ""))
        rows.append(
            [spaced(name), number(stated, 4), _tolerance(tolerance), number(fitted, 4), corrected, unit, text]
        )
    columns = ("parameter", "stated", "known to", "recalibrated", "with the causes", "unit", "moved by")
    return PageTable(columns, rows, words=(0, 5, 6), marked=marked)


def _tolerance(tolerance: float | str) -> str:
    if isinstance(tolerance, str):
        return "not known" if tolerance == "free" else tolerance
    return "exactly" if tolerance == 0 else f"\u00b1 {100 * tolerance:.3g} %"


def _moved(stated: float, tolerance: float | str, fitted: float) -> tuple[str, bool]:
    """Return by how much a parameter moved, and whether that is farther than its tolerance makes likely."""
    if fitted == stated:
        return "not at all", False
    if stated == 0 or not math.isfinite(fitted / stated):
        return f"by {number(fitted - stated)}", False
    factor = fitted / stated
    text = f"{number(factor)} times the stated" if not 0.5 <= factor <= 2 else f"{100 * (factor - 1):+.2g} %"
    if isinstance(tolerance, str) or tolerance == 0:
        return text, False
    steps = abs(factor - 1) / tolerance
    return f"{text}, {number(steps, 2)} of its tolerances", steps >= _FAR


def _noise(diagnosis: Diagnosis) -> PageTable:
    units = dict(diagnosis.channels)
    rows = [[spaced(name), scatter_text(sd, units.get(name, "1"))] for name, sd in diagnosis.noise.items()]
    return PageTable(("output", "noise of one trial (sd)"), rows)
