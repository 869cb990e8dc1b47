"""The diagnosis of a run's gap to its model, in the run's report: the verdict, and where the whole of it is."""

from labrun.errors import RequestError
from labrun.report.gap_page import PAGE
from labrun.report.gap_store import FOLDER, read_stored
from labrun.report.html_elements import Html, element, joined, paragraph, section
from labrun.report.report_source import ReportSource


def gap_section(source: ReportSource) -> Html | None:
    """Return the verdict of the newest diagnosis, with a link to its page; None if there is none."""
    if source.folder is None or not (source.folder / FOLDER).is_dir():
        return None
    try:
        stored = read_stored(source.folder)
    except RequestError as error:
        return section("gap", "Gap", paragraph(str(error), class_="stop"))
    page = source.folder / FOLDER / PAGE
    parts = [paragraph(str(stored.get("sentence", stored["verdict"])))]
    if page.is_file():
        parts.append(element("p", element("a", "The whole diagnosis", href=f"{FOLDER}/{PAGE}")))
    model = f"Against {stored.get('model', 'its model')}."
    return section("gap", "Gap to the model", joined([*parts, paragraph(model, class_="note")]))
