"""Where the bench's time went, and how well the sensors kept theirs."""

from labrun.report.bench_time import STEPS, BenchTime
from labrun.report.command_health import command_health
from labrun.report.html_elements import Content, Html, element, joined, paragraph, section, share_bar, table
from labrun.report.loop_health import loop_words
from labrun.report.report_source import ReportSource
from labrun.report.statistics import LEAST_JITTER_S, clock_text
from labrun.report.text import counted, duration_text, share_text


def timing_section(source: ReportSource) -> Html | None:
    """Return bench time by step and the health of the streams; None before any trial."""
    if not source.run.outcomes:
        return None
    return section("timing", "Timing", _bench(source), _loop(source), _commands(source), _streams(source))


def _bench(source: ReportSource) -> Html | None:
    spent = source.bench_time
    if spent is None:
        return None
    longest = max(STEPS, key=spent.of)
    text = (
        f"{duration_text(spent.total_s)} of bench time, {_each(source, spent)} a trial; "
        f"{share_text(spent.of(longest), spent.total_s)} went to {_WORDS[longest]}."
    )
    rows: list[list[Content]] = [
        [
            _WORDS[step],
            share_bar(spent.of(step) / spent.total_s),
            share_text(spent.of(step), spent.total_s),
            duration_text(spent.of(step)),
            f"{spent.median_s(step):.2g} s" if spent.median_s(step) < 10 else f"{spent.median_s(step):.0f} s",
        ]
        for step in STEPS
        if step in spent.steps
    ]
    rates = "" if not source.dry_run else " Storing takes no time on the simulated clock of a dry run."
    return joined(
        [
            paragraph(text),
            table(("step", "", "share", "in all", "median of a trial"), rows, words=(0, 1)),
            paragraph(f"By the journal; pauses of an interrupted run are not counted.{rates}", class_="note"),
        ]
    )


_WORDS = {
    "move": "moving to the start",
    "settle": "settling",
    "tare": "taring",
    "record": "recording",
    "safe pose": "moving to the safe pose",
    "store": "storing",
}


def _each(source: ReportSource, spent: BenchTime) -> str:
    mean_s = spent.total_s / len(source.run.outcomes)
    return f"{mean_s:.3g} s" if mean_s < 60 else duration_text(mean_s)


def _loop(source: ReportSource) -> Html | None:
    """Return how the closed loop kept its time; None without one."""
    if source.loop is None:
        return None
    words = loop_words(source.loop)
    note = (
        "Latency is the time from the newest sample that a step used to the command it sent. A step that begins more "
        "than a period behind its deadline is left out, never caught up with."
    )
    class_ = "stop" if source.loop.missed else None
    return joined(
        [
            element("h3", "Loop"),
            paragraph(f"The loop ran {words}.", class_=class_),
            paragraph(note, class_="note"),
        ]
    )


def _commands(source: ReportSource) -> Html | None:
    """Return how evenly set-points went out; None where no device tells."""
    found = command_health(source.run.events)
    if not found:
        return None
    rows: list[list[Content]] = [
        [
            item.device,
            f"{item.rate_hz:.4g}",
            str(item.sent),
            f"{item.missed} ({share_text(item.missed, item.sent + item.missed)})" if item.missed else "0",
            *(f"{1e3 * late_s:.2g}" for late_s in (item.late_median_s, item.late_p99_s, item.late_worst_s)),
        ]
        for item in found
    ]
    columns = ("device", "rate (Hz)", "sent", "skipped", "late, median (ms)", "99 % (ms)", "worst (ms)")
    return joined(
        [
            element("h3", "Commands"),
            table(columns, rows, words=(0,)),
            paragraph(
                "Late is the time from when a set-point was due to when its sending began: medians of the trials' "
                "own figures, and the worst of all. A set-point whose successor is due already is skipped.",
                class_="note",
            ),
        ]
    )


def _streams(source: ReportSource) -> Html | None:
    if not source.streams:
        return None
    channels = source.run.signals(source.run.outcomes[0].index)
    rows: list[list[Content]] = []
    for item in source.streams:
        stream = channels.get(item.device)
        names = (
            ", ".join(
                f"{name} ({unit})" if unit else name
                for name, unit in zip(stream.columns, stream.units, strict=True)
            )
            if stream
            else ""
        )
        rows.append(
            [
                item.device,
                names,
                f"{item.nominal_hz:.4g}",
                f"{item.actual_hz:.4g}",
                f"{1000 * item.jitter_s:.2g}" if item.jitter_s > LEAST_JITTER_S else "0",
                *clock_text(item),
                str(item.samples),
                f"{item.lost} ({share_text(item.lost, item.samples + item.lost)})" if item.lost else "0",
                str(item.saturated),
            ]
        )
    columns = (
        "device", "channels", "nominal (Hz)", "actual (Hz)", "jitter, sd (ms)", "clock offset", "drift",
        "samples", "lost", "saturated",
    )  # fmt: skip
    looked = len(source.streams_looked_at)
    of = (
        f"all {looked}"
        if looked == len(source.run.outcomes)
        else f"{looked} of {len(source.run.outcomes)}, evenly over the run"
    )
    return joined(
        [
            element("h3", "Streams"),
            table(
                columns,
                rows,
                words=(0, 1),
                marked=[n for n, s in enumerate(source.streams) if s.saturated],
            ),
            paragraph(
                f"From {counted(looked, 'trial')} ({of}). Jitter is the sd of the time between samples by the device's "
                "own clock, gaps of lost samples left out. The offset is the run's clock minus the device's; sample "
                "times have it in them already.",
                class_="note",
            ),
        ]
    )
