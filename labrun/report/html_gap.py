"""The diagnosis of a run's gap to its model, in the run's report: the verdict, and where the whole of it is."""

from labrun.report.html_elements import Html, element, joined, paragraph, section
from labrun.report.report_source import ReportSource


def gap_section(source: ReportSource) -> Html | None:
    """Return the verdict of the newest diagnosis, with a link to its page; None if there is none."""
    stored = source.diagnosis
    if stored is None:
        return None
    if stored.fault:
        return section("gap", "Gap", paragraph(stored.fault, class_="stop"))
    numbers = stored.numbers
    parts = [paragraph(str(numbers.get("sentence", numbers["verdict"])))]
    if stored.page is not None:
        parts.append(element("p", element("a", "The whole diagnosis", href=stored.page)))
    model = f"Against {numbers.get('model', 'its model')}."
    return section("gap", "Gap to the model", joined([*parts, paragraph(model, class_="note")]))
