"""How far a run can be believed: repeatability, drift, settling."""

import math

from labrun.report.html_elements import Content, Html, paragraph, picture, section, table
from labrun.report.report_source import ReportSource
from labrun.report.statistics import Drift, Repeatability, Settling, settling
from labrun.report.text import counted, duration_text, scatter_text, share_text, slope_words, spaced


def repeatability_section(source: ReportSource) -> Html | None:
    """Return how far repeats of one condition lie apart; None where nothing says so."""
    found = source.repeatability
    if not found:
        if not source.experiment.objectives or not source.accepted:
            return None
        text = "No condition was measured more than once, so the noise of a trial is not known. Set trial.repeats."
        return section("repeatability", "Repeatability", paragraph(text))
    from labrun.report.repeatability_figure import draw_repeatability

    main = next((item for item in found if item.objective == source.view.objective), found[0])
    rows: list[list[Content]] = [
        [
            spaced(item.objective),
            scatter_text(item.sd, item.unit),
            "" if item.between_sd is None else scatter_text(item.between_sd, item.unit),
            str(item.degrees_of_freedom),
        ]
        for item in found
    ]
    columns = ("objective", "sd within a condition", "sd between conditions", "degrees of freedom")
    alt = f"Standard deviation of repeated trials against the mean of {main.objective}, one dot a condition"
    caption = "Every dot is a condition. The band is where 95 % of them would lie if all had the pooled sd."
    return section(
        "repeatability",
        "Repeatability",
        paragraph(_what_it_resolves(source, main)),
        picture(draw_repeatability(source.view, main), "svg+xml", alt=alt, caption=caption),
        table(columns, rows),
    )


def drift_section(source: ReportSource) -> Html | None:
    """Return how the reference trials changed over the run; None where there are no objectives."""
    if not source.experiment.objectives or not source.run.outcomes:
        return None
    if not source.drift:
        references = sum(outcome.role == "reference" for outcome in source.run.outcomes)
        there = f"There {'is' if references == 1 else 'are'} {counted(references, 'reference trial')}"
        text = (
            f"{there}: three accepted ones, at different times, are the least to see drift by. trial.reference asks "
            "for one every so many trials."
        )
        return section("drift", "Drift", paragraph(text))
    from labrun.report.drift_figure import MOST_PANELS, draw_drift

    restarted = (
        "The run's clock began anew in its course (the machine was restarted), so that times before and after do not "
        "compare and these slopes mean little."
    )
    alt = "Reference trials over bench time with the line through them, for " + ", ".join(
        item.objective for item in source.drift[:MOST_PANELS]
    )
    caption = "Reference trials, the straight line through them, and the 95 % band of the line."
    return section(
        "drift",
        "Drift, by reference trials",
        paragraph(restarted, class_="stop") if source.clock_restarted else None,
        *(paragraph(drift_sentence(source, item)) for item in source.drift),
        picture(draw_drift(source.view, source.drift), "svg+xml", alt=alt, caption=caption),
    )


def settling_section(source: ReportSource) -> Html | None:
    """Return how the bench came to rest before trials; None where the experiment does not wait."""
    found = settling(source.run.outcomes)
    if found is None:
        return None
    from labrun.report.settling_figure import draw_settling

    text = (
        f"{_why_it_went_on(found)} Half of the waits took {found.median_s:.3g} s or less, the longest "
        f"{_seconds(found.longest_s)}."
    )
    watched = {outcome.settle.channel for outcome in source.run.outcomes if outcome.settle is not None}
    channels = ", ".join(sorted(channel for channel in watched if channel))
    caption = f"Watched: {channels}." if channels else None
    alt = "Distribution of settle times by reason, and settle times in the order of the trials"
    return section(
        "settling",
        "Settling",
        paragraph(text),
        picture(draw_settling(source.run.outcomes), "svg+xml", alt=alt, caption=caption),
    )


def _seconds(duration_s: float) -> str:
    return f"{duration_s:.3g} s" if duration_s < 60 else duration_text(duration_s)


def _why_it_went_on(found: Settling) -> str:
    total = sum(found.reasons.values())
    if set(found.reasons) == {"quiet"}:
        return f"Before all {counted(total, 'trial')} the bench was quiet."
    if set(found.reasons) == {"time"}:
        return f"{counted(total, 'trial')} began after a fixed time; whether the bench was at rest was not looked at."
    words = {
        "quiet": "the bench was quiet",
        "timeout": "time was up and the bench still moving",
        "time": "a fixed time",
    }
    parts = [
        f"{words.get(reason, reason)} before {count} ({share_text(count, total)})"
        for reason, count in found.reasons.items()
    ]
    return f"Of {counted(total, 'trial')}: {', '.join(parts)}."


def drift_sentence(source: ReportSource, item: Drift) -> str:
    """Return what the reference trials say of one objective: how fast it drifts, or how much drift could hide."""
    hours = _hours(source)
    slope = slope_words(item.slope_per_h, item.ci95, item.unit)
    sd = source.sd_of(item.objective)
    name = spaced(item.objective)
    if item.visible:
        change = item.slope_per_h * hours
        text = (
            f"{name} drifts: {slope} by {counted(item.trials, 'reference trial')}, "
            f"{scatter_text(change, item.unit)} over the run's {hours:.2g} h"
        )
        text += f", {abs(change) / sd:.2g} times the scatter of a single trial." if sd else "."
        return _capital(text)
    most = most_hidden(source, item)
    text = (
        f"{name} shows no drift: {slope} by {counted(item.trials, 'reference trial')}. "
        f"Up to {scatter_text(most, item.unit)} over the run's {hours:.2g} h could hide in that"
    )
    text += f"; a single trial scatters by {scatter_text(sd, item.unit)}." if sd else "."
    return _capital(text)


def most_hidden(source: ReportSource, item: Drift) -> float:
    """Return how far the bench may have drifted over the whole run without the references showing it."""
    return max(abs(end) for end in item.ci95) * _hours(source)


def _what_it_resolves(source: ReportSource, item: Repeatability) -> str:
    from scipy.stats import t

    from labrun.report.repeatability_figure import grows_with_size, spreads

    means, sds, counts = spreads(source.view, item.objective)
    repeats = round(float(sorted(counts.tolist())[len(counts) // 2]))
    least = float(t.ppf(0.975, item.degrees_of_freedom)) * item.sd * math.sqrt(2 / repeats)
    text = (
        f"A single trial of {spaced(item.objective)} scatters by {scatter_text(item.sd, item.unit)} (sd, pooled over "
        f"{counted(len(means), 'condition')}), a mean of {repeats} by "
        f"{scatter_text(item.sd / math.sqrt(repeats), item.unit)}. Two given conditions with {repeats} trials each "
        f"differ beyond chance (95 %) when their means are more than {scatter_text(least, item.unit)} apart."
    )
    correlation = grows_with_size(means, sds)
    if correlation is not None:
        kind = "larger" if correlation > 0 else "smaller"
        text += (
            f" The scatter is {kind} where the value is larger (rank correlation {correlation:.2f}), so the pooled sd "
            "stands for the middle of the range only."
        )
    return text


def _hours(source: ReportSource) -> float:
    starts = [outcome.started_s for outcome in source.run.outcomes]
    return (max(starts) - min(starts)) / 3600


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
