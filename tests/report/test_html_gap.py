"""What a run's report says of its diagnosis."""

from types import SimpleNamespace

import gap_examples as examples

from labrun.app.diagnose import store
from labrun.app.report import stored_gap, write_report
from labrun.app.run import execute
from labrun.report.html_gap import gap_section
from labrun.runner import SilentProgress
from labrun.spec import load_named
from labrun.store import open_run


def of(folder):
    return gap_section(SimpleNamespace(diagnosis=None if folder is None else stored_gap(folder)))


def test_a_run_without_a_diagnosis_has_no_such_section(tmp_path):
    assert of(tmp_path) is None
    assert of(None) is None


def test_the_verdict_stands_in_the_report_with_a_link_to_the_whole(tmp_path):
    diagnosis = examples.explained()
    store(diagnosis, tmp_path, tmp_path)
    text = str(of(tmp_path))
    assert 'href="gap/gap.html"' in text
    assert diagnosis.sentence.split(":")[0] in text


def test_a_diagnosis_without_a_page_is_told_without_a_link(tmp_path):
    store(examples.no_gap(), tmp_path, tmp_path, page=False)
    text = str(of(tmp_path))
    assert "href" not in text
    assert examples.no_gap().sentence.split(":")[0] in text


def test_a_damaged_diagnosis_is_told_as_such_and_how_to_make_it_anew(tmp_path):
    (tmp_path / "gap").mkdir()
    (tmp_path / "gap" / "diagnosis.json").write_text("{")
    assert "labrun gap diagnose" in str(of(tmp_path))


def test_a_run_that_has_only_a_reference_trial_so_far_has_a_report(tmp_path):
    run = execute(
        load_named("fin-params", tmp_path),
        results=tmp_path,
        dry_run=True,
        seed=1,
        limit=1,
        progress=SilentProgress(),
    ).run
    assert "no condition has been measured yet" in write_report(open_run(run)).read_text()
