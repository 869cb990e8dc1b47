"""The top of a diagnosis: the verdict in a sentence, how sure it is, and the numbers that carry it."""

from labrun.gap.diagnosis import Cause, Diagnosis
from labrun.report.html_elements import Html, element, joined, paragraph
from labrun.report.text import (
    HEADLINES,
    data_words,
    listed,
    never_seen,
    percent,
    times_noise,
    value_words,
)


def gap_head(diagnosis: Diagnosis) -> Html:
    """Return title, verdict, the numbers beside it, and what the data cannot tell apart."""
    gap = diagnosis.gap
    return joined(
        [
            paragraph(
                f"Measured: {diagnosis.name}. Model: {diagnosis.model}. Verdict: {HEADLINES[diagnosis.verdict]}.",
                class_="where",
            ),
            element("h1", diagnosis.sentence),
            element(
                "div",
                *_numbers(diagnosis),
                *(_cause_line(cause, len(diagnosis.causes) > 1) for cause in diagnosis.causes),
                class_="best",
            ),
            paragraph(
                f"A gap of 1 is as large as the noise of a single trial; noise alone would leave up to "
                f"{times_noise(gap.floor)}. From {data_words(diagnosis)}.",
                class_="note",
            ),
            *(
                _doubt(cause, bool(diagnosis.what_next))
                for cause in diagnosis.causes
                if cause.indistinguishable_from
            ),
            _limits(diagnosis),
        ]
    )


def _numbers(diagnosis: Diagnosis) -> list[Html]:
    gap, found = diagnosis.gap, []
    if len(diagnosis.causes) == 1:
        found.append(
            _fact(
                "confidence in this cause",
                percent(diagnosis.causes[0].confidence),
                "learned from cases with known causes",
            )
        )
    if diagnosis.causes:
        found.append(
            _fact("gap, without and with the cause" + "s" * (len(diagnosis.causes) > 1),
                  f"{times_noise(gap.recalibrated)} \u2192 {times_noise(gap.after)}", never_seen(diagnosis))
        )  # fmt: skip
    else:
        found.append(
            _fact("gap, as stated and recalibrated", f"{times_noise(gap.raw)} \u2192 {times_noise(gap.recalibrated)}",
                  f"noise alone leaves up to {times_noise(gap.floor)}")
        )  # fmt: skip
    share = diagnosis.shrinkage
    if share is not None and diagnosis.causes:
        found.append(
            _fact("share of the gap that closes", percent(share.value),
                  f"90 % interval {percent(share.low)} to {percent(share.high)}")
        )  # fmt: skip
    return found


def _fact(title: str, value: str, below: str) -> Html:
    return element("div", element("span", title), element("b", value), element("span", below))


def _cause_line(cause: Cause, several: bool) -> Html:
    values = "; ".join(value_words(cause.values))
    told = f": {values} (95 % interval)" if values else ""
    told += f", confidence {percent(cause.confidence)}" if several else ""
    told += f". {_sentence(cause.remark)}" if cause.remark else ""
    return element("div", element("strong", cause.name.words), told, class_="at")


def _sentence(text: str) -> str:
    text = text.strip()
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}"


def _doubt(cause: Cause, has_next: bool) -> Html:
    others = listed([name.words for name in cause.indistinguishable_from], "or")
    return paragraph(
        f"These data cannot tell {cause.name.words} from {others}: any of them explains what was measured as "
        "well. ",
        element("a", "What to measure next", href="#next") if has_next else None,
        class_="stop",
    )


def _limits(diagnosis: Diagnosis) -> Html | None:
    number = len(diagnosis.limitations)
    if not number:
        return None
    what = "One thing" if number == 1 else f"{number} things"
    return paragraph(
        f"{what} these data do not allow to say: ", element("a", "limitations", href="#limits"), "."
    )
