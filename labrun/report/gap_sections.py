"""The body of a diagnosis: where the gap is, which candidates there are, how far it closes, and what to do next."""

from collections.abc import Callable, Sequence

from labrun.gap.diagnosis import Diagnosis, MissingForce, Trace
from labrun.report.gap_force_figure import force_png
from labrun.report.gap_how_far_figure import how_far_svg
from labrun.report.gap_places import hot_spots, place_words
from labrun.report.gap_traces_figure import shown_traces, traces_svg, worst_outputs
from labrun.report.gap_where_figure import where_svg
from labrun.report.html_elements import (
    Content,
    Html,
    element,
    folded,
    joined,
    paragraph,
    picture,
    section,
    table,
)
from labrun.report.text import (
    never_seen,
    p_words,
    percent,
    times_noise,
)
from labrun.spec import condition_key

_MOST_FORCES = 2


def where_section(diagnosis: Diagnosis) -> Html:
    """Return where model and measurement differ: shares, traces, and the force that is missing."""
    return section(
        "where",
        "Where they differ",
        _in_a_sentence(diagnosis),
        _shares(diagnosis),
        _traces(diagnosis),
        *(_force(missing) for missing in _forces(diagnosis)),
        _all_places(diagnosis),
    )


def _in_a_sentence(diagnosis: Diagnosis) -> Html:
    if diagnosis.verdict == "no-gap":
        return paragraph(
            "After recalibration nothing is left that noise alone would not leave: the parts below are chance."
        )
    told = hot_spots(diagnosis.where)
    if not told:
        return paragraph("No part of the data stands out beyond chance in what is left after recalibration.")
    items = [
        element(
            "li",
            element("b", percent(one.share)),
            f" {one.text}",
            f" ({p_words(one.p)})" if one.p is not None else "",
        )
        for one in told
    ]
    return joined(
        [paragraph("Of what is left after recalibration, beyond the noise:"), element("ul", *items)]
    )


def _shares(diagnosis: Diagnosis) -> Html | None:
    return _drawn(
        lambda: where_svg(diagnosis),
        "svg+xml",
        alt="Shares of the excess over the noise; the table below has all of them",
        caption="Each panel divides the same excess over the noise in another way; parts of a panel may overlap. Dark: "
        "noise alone would give the part as much with a probability p of at most 0.05, corrected for all the places "
        "looked at. Grey: may be chance. Light blue: could not be tested.",
    )


def _traces(diagnosis: Diagnosis) -> Html | None:
    traces = shown_traces(diagnosis)
    if not traces:
        return None
    causes = ", and with the causes added" if diagnosis.causes else ""
    courses = any(len(trace.time_s) > 1 for trace in traces)
    rest = (
        " Above, measured over simulated, where it is many cycles in the few that are worst; below, measured - "
        "simulated over the whole trial, with dashed lines about these; grey, two standard deviations of one trial."
        if courses
        else ""
    )
    return _drawn(
        lambda: traces_svg(diagnosis),
        "svg+xml",
        alt="Measured and simulated outputs where they differ most",
        caption=f"Where they differ most{_chosen(diagnosis, traces)}: measured, and simulated with the model as "
        f"stated, with its parameters recalibrated{causes}.{rest}",
    )


def _chosen(diagnosis: Diagnosis, traces: Sequence[Trace]) -> str:
    """Return which conditions and outputs are shown, where it is not all of them."""
    conditions = len({condition_key(trace.condition) for trace in traces})
    outputs = len(worst_outputs(diagnosis, traces))
    told = []
    if conditions < diagnosis.conditions:
        told.append(f"{conditions} of {diagnosis.conditions} conditions")
    if outputs < len(diagnosis.channels):
        told.append(f"{outputs} of {len(diagnosis.channels)} outputs")
    return f" ({' and '.join(told)})" if told else ""


def _forces(diagnosis: Diagnosis) -> list[MissingForce]:
    return sorted(diagnosis.missing, key=lambda one: -one.share)[:_MOST_FORCES]


def _force(missing: MissingForce) -> Html | None:
    found = _drawn(
        lambda: force_png(missing),
        "png",
        alt=f"What is missing at {missing.site}",
        caption=f"What would have to be added at {missing.site} over time to close the gap; it explains "
        f"{percent(missing.share)} of the excess. Black: mean. A curve that repeats itself over one of these axes "
        "is a law to look for; a cloud is none.",
    )
    return joined([element("h3", f"What is missing at {missing.site}"), found]) if found else None


def _all_places(diagnosis: Diagnosis) -> Html | None:
    rows: list[list[Content]] = [
        [place.by, place_words(place), percent(place.share), "" if place.p is None else f"{place.p:.3g}"]
        for place in diagnosis.where
    ]
    if not rows:
        return None
    return folded(
        "All parts as a table", table(("by", "part", "share of the excess", "p"), rows, words=(0, 1))
    )


def how_far_section(diagnosis: Diagnosis) -> Html:
    """Return how far the gap closes, on data the fit did not see."""
    gap, share = diagnosis.gap, diagnosis.shrinkage
    told = [
        f"As stated, the model is off by {times_noise(gap.raw)} times the noise of one trial; with its parameters "
        f"recalibrated within what is known of them, by {times_noise(gap.recalibrated)}"
    ]
    if diagnosis.causes:
        several = len(diagnosis.causes) > 1
        told.append(f"; with the cause{'s' * several} above added, by {times_noise(gap.after)}")
    told.append(f". Noise alone would leave up to {times_noise(gap.floor)}.")
    if share is not None and diagnosis.causes:
        told.append(
            f" So {percent(share.value)} of the recalibrated excess (90 % interval {percent(share.low)} to "
            f"{percent(share.high)}) goes away, measured {never_seen(diagnosis)}."
        )
    drawn = _drawn(
        lambda: how_far_svg(diagnosis),
        "svg+xml",
        alt="Gap as stated, recalibrated, with the causes, and the noise floor",
        caption="The excess is the square of the gap: a gap half as large is a quarter of the excess.",
    )
    return section("far", "How far it closes", paragraph("".join(told)), drawn)


def next_section(diagnosis: Diagnosis) -> Html | None:
    """Return what to do now; None where nothing is."""
    if not diagnosis.what_next:
        return None
    return section("next", "What next", element("ul", *(element("li", text) for text in diagnosis.what_next)))


def _drawn(draw: Callable[[], bytes | None], kind: str, *, alt: str, caption: str) -> Html | None:
    try:
        data = draw()
    except Exception as error:  # a picture that cannot be drawn must not cost the numbers beside it
        return paragraph(f"A figure could not be drawn: {type(error).__name__}: {error}", class_="stop")
    return None if data is None else picture(data, kind, alt=alt, caption=caption)
