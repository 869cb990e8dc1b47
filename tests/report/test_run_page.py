"""The report of real runs, as whoever opens it finds it."""

import base64
import hashlib
import json
import re
import shutil

import gap_examples as examples
import pytest
from rendering import rendered
from report_runs import measure
from typer.testing import CliRunner

from labrun.app.diagnose import store
from labrun.app.report import read_findings, write_report
from labrun.cli.app import app
from labrun.errors import RecordingError
from labrun.report.text import interval_words
from labrun.report.timing import stream_health
from labrun.search import stored_result
from labrun.store import RunFolder, import_recording, open_run


@pytest.fixture
def copy(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "fin-params" / finished.name)


def page_of(target, output=None):
    with open_run(target) as run:
        return write_report(read_findings(run), output).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(finished, tmp_path_factory):
    with rendered():
        return page_of(finished, tmp_path_factory.mktemp("page") / "report.html")


@pytest.fixture(scope="module")
def unfinished_page(unfinished, tmp_path_factory):
    return page_of(unfinished, tmp_path_factory.mktemp("page") / "report.html")


@pytest.fixture(scope="module")
def annotated(finished, tmp_path_factory):
    """The page of a run with spoiled trials, fits, one of them damaged, and a diagnosis."""
    copy = shutil.copytree(finished, tmp_path_factory.mktemp("annotated") / finished.name)
    folder = RunFolder.open(copy)
    with folder.lock():
        folder.mark(3, "rejected", "a <b>wave</b> went through the tank")
        folder.mark(4, "failed", "device wrench: no sample for 2 s")
    fit = {
        "parameters": {
            "stiffness": {"value": 0.0108, "ci95": [0.0089, 0.0129], "unit": "N m/rad"},
            "offset": {"value": 0.3, "ci95": None, "unit": "rad"},
        },
        "rmse": {"angle": 0.00625},
        "warnings": ["the data say little of the stiffness"],
        "model": "hinge",
        "condition_number": 41.5,
        "findings": ["it would take a, b"],
        "tables": [
            {"title": "baskets", "header": ["basket", "MAE"], "rows": [["a, b", "7.9 %"], ["torn"]]},
            "no table",
        ],
    }
    (copy / "fit").mkdir()
    (copy / "fit" / "fit.json").write_text(json.dumps(fit))
    (copy / "fit" / "damaged.json").write_text('{"parameters": ')
    store(examples.explained(), copy / "gap")
    return page_of(copy)


def words_of(text):
    body = re.sub(r"<(style|script)>.*?</\1>", "", text, flags=re.S)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", body)).replace("\u00a0", " ")


@pytest.mark.parametrize("left", ['{"trials": ', "{}", "[]", '{"trials": 3, "figure": null, "best": null}'])
def test_a_damaged_result_is_told_with_the_way_to_write_it_anew(copy, left):
    (copy / "result.json").write_text(left)
    with pytest.raises(RecordingError, match=r"result\.json is damaged") as refusal:
        page_of(copy)
    assert "labrun resume" in refusal.value.hint


def test_a_report_tells_the_honest_best_with_its_interval_and_the_luckiest_beside_it(finished, page):
    best = stored_result(finished).best
    words = words_of(page)
    with open_run(finished) as run:
        assert read_findings(run).best == best
    value, interval = interval_words(best.value, best.ci95, best.unit)
    assert f"{value} 95 % interval {interval}" in words
    assert f"luckiest single trial {best.luckiest:.4g} N" in words
    assert "5 confirming trials that took no part in the choice" in words
    assert "a = 60 deg" in words


def test_a_report_loads_nothing_and_runs_only_its_own_script(page):
    (script,) = re.findall(r"<script>(.*?)</script>", page, re.S)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page).group(1).replace("&#39;", "'")
    assert policy.startswith("default-src 'none'; img-src data:;")
    assert policy.endswith(f"script-src 'sha256-{digest}'")
    without = re.sub(r' xmlns(:xlink)?="[^"]*"', "", page)
    assert "http://" not in without.split("<pre>")[0]
    assert set(re.findall(r' src="([^:]+):', page)) <= {"data"}
    assert set(re.findall(r' href="(.)', page)) == {"#"}


def test_a_report_is_read_from_the_top_down(page):
    anchors = re.findall(r'<section id="([a-z]+)">', page)
    assert anchors == [
        "result", "conditions", "repeatability", "drift", "settling", "timing", "rejected", "provenance",
    ]  # fmt: skip


def test_every_link_leads_somewhere(page):
    assert set(re.findall(r'href="#([^"]+)"', page)) <= set(re.findall(r' id="([^"]+)"', page))


@pytest.mark.rendered
def test_the_same_run_gives_the_same_report(finished, page, tmp_path):
    assert page_of(finished, tmp_path / "again.html") == page


def test_bench_time_is_that_of_the_run_s_clock(copy):
    with open_run(copy) as run:
        first = next(event["clock_s"] for event in run.events if event["event"] == "prepare")
        last = json.loads(run.outcomes[-1].checkpoint)["clock_s"]
        assert read_findings(run).bench_time_s == pytest.approx(last - first)


def test_a_packed_file_alone_tells_the_same_best(finished, tmp_path):
    alone = tmp_path / "kept.h5"
    shutil.copy(finished / "run.h5", alone)
    with open_run(alone) as run:
        findings = read_findings(run)
        written = write_report(findings)
    assert written == tmp_path / "kept-report.html"
    assert findings.best == stored_result(finished).best
    assert "not finished" not in written.read_text(encoding="utf-8")


def test_an_unfinished_run_says_so_and_how_to_go_on(unfinished, unfinished_page):
    words = words_of(unfinished_page)
    assert "This run is not finished: what follows is the state after 4 trials" in words
    assert f"labrun resume {unfinished}" in words
    assert "No best can be named yet" in words


def test_rejected_trials_are_listed_with_their_reasons(annotated):
    assert "a &lt;b&gt;wave&lt;/b&gt; went through the tank" in annotated
    assert "1 rejected and 1 failed of" in words_of(annotated)
    assert "<b>wave" not in annotated


def test_names_from_the_file_stay_text(unfinished_page):
    assert unfinished_page.count("<script") == 1
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in unfinished_page


def test_a_fit_in_the_run_s_folder_is_shown_with_intervals_and_warnings(annotated):
    words = words_of(annotated)
    for text in ("0.0089 to 0.0129", "not known", "the data say little", "condition number 41.5", "0.00625"):
        assert text in words


def test_a_damaged_fit_does_not_cost_the_report(annotated):
    assert "damaged.json cannot be read" in annotated


def test_tables_and_findings_of_a_fit_are_shown_as_it_prints_them(annotated):
    words = words_of(annotated)
    assert "A model was fitted to it: what came of it" in words
    assert "baskets basket MAE a, b 7.9 %" in words
    assert "it would take a, b" in words
    assert "torn" not in words


def test_an_imported_recording_has_a_report(tmp_path):
    folder = tmp_path / "swing"
    folder.mkdir()
    (folder / "recording.toml").write_text(
        'experiment = "swing"\n[channels.angle]\nkind = "output"\nunit = "rad"\n'
        '[[trials]]\nfile = "a.csv"\ncondition = { release = 10 }\n'
    )
    rows = "\n".join(f"{0.01 * k:.2f},{(-0.9) ** k:.5f}" for k in range(50))
    (folder / "a.csv").write_text(f"time_s,angle\n{rows}\n")
    text = page_of(import_recording(folder, tmp_path / "results"))
    words = words_of(text)
    assert "A recording made elsewhere, imported: 1 trial at 1 condition" in words
    assert "angle (rad)" in words
    assert '<section id="result">' in text
    assert "<svg" in text


def test_a_recording_of_several_trials_has_a_report_that_tells_no_clock(tmp_path):
    folder = tmp_path / "swing"
    folder.mkdir()
    trials = "".join(f'[[trials]]\nfile = "{k}.csv"\ncondition = {{ release = {k} }}\n' for k in range(3))
    (folder / "recording.toml").write_text(
        f'experiment = "swing"\n[channels.angle]\nkind = "output"\nunit = "rad"\n{trials}'
    )
    for trial in range(3):
        rows = "\n".join(f"{0.01 * k:.2f},{(trial + 1) * (-0.9) ** k:.5f}" for k in range(50))
        (folder / f"{trial}.csv").write_text(f"time_s,angle\n{rows}\n")
    with open_run(folder) as run:
        findings = read_findings(run)
        (stream,) = stream_health(findings, range(3))
        words = words_of(write_report(findings, tmp_path / "swing.html").read_text(encoding="utf-8"))
    assert "3 trials at 3 conditions" in words
    assert (stream.clock_offset_s, stream.clock_drift_ppm) == (None, None)


def test_every_published_recording_has_a_report(recordings, tmp_path):
    for folder in sorted(recording.parent for recording in recordings.glob("*/recording.toml")):
        assert "</html>" in page_of(folder, tmp_path / f"{folder.name}.html")


def test_the_command_writes_where_it_is_told_and_says_where(copy, tmp_path):
    to = tmp_path / "pages" / "night.html"
    done = CliRunner().invoke(app, ["report", str(copy), "--output", str(to), "--json"])
    assert done.exit_code == 0
    assert json.loads(done.stdout) == {"report": str(to)}
    assert to.read_text(encoding="utf-8").startswith("<!doctype html>")


def test_a_report_that_cannot_be_written_is_an_error_that_says_so(copy, tmp_path):
    (tmp_path / "file").write_text("")
    done = CliRunner().invoke(app, ["report", str(copy), "--output", str(tmp_path / "file" / "x.html")])
    assert done.exit_code == 1
    assert "cannot be written" in done.stderr


def test_show_knows_an_imported_recording_too(tmp_path):
    folder = tmp_path / "swing"
    folder.mkdir()
    (folder / "recording.toml").write_text(
        '[channels.angle]\nkind = "output"\nunit = "rad"\n[[trials]]\nfile = "a.csv"\n'
    )
    (folder / "a.csv").write_text("time_s,angle\n0,1\n0.1,0.5\n0.2,0.2\n")
    run = import_recording(folder, tmp_path / "results")
    done = CliRunner().invoke(app, ["show", str(run), "--json"])
    assert done.exit_code == 0
    assert json.loads(done.stdout)["finished"] is True


def gap_of(text):
    return text.partition('<section id="gap">')[2].partition("</section>")[0]


def test_a_run_without_a_diagnosis_has_no_such_section(unfinished_page):
    assert gap_of(unfinished_page) == ""


def test_the_verdict_stands_in_the_report_with_a_link_to_the_whole(annotated):
    text = gap_of(annotated)
    assert 'href="gap/gap.html"' in text
    assert examples.explained().sentence.split(":")[0] in text


def test_a_diagnosis_without_a_page_is_told_without_a_link(unfinished, tmp_path):
    copy = shutil.copytree(unfinished, tmp_path / unfinished.name)
    store(examples.no_gap(), copy / "gap", page=False)
    text = gap_of(page_of(copy))
    assert "href" not in text
    assert examples.no_gap().sentence.split(":")[0] in text


def test_a_damaged_diagnosis_is_told_as_such_and_how_to_make_it_anew(unfinished, tmp_path):
    copy = shutil.copytree(unfinished, tmp_path / unfinished.name)
    (copy / "gap").mkdir()
    (copy / "gap" / "diagnosis.json").write_text("{")
    assert "labrun gap diagnose" in gap_of(page_of(copy))


def test_a_run_that_has_only_a_reference_trial_so_far_has_a_report(tmp_path):
    run = measure(tmp_path, limit=1)
    assert "no condition has been measured yet" in page_of(run)


def test_a_search_for_each_level_tells_the_winners_side_by_side_and_how_each_search_ended(tmp_path):
    small = (
        "cmaes.population=4", "cmaes.reevaluate=1", "cmaes.stop.iterations=2", "trial.repeats=1",
        "leaders={count=1,repeats=3}", 'cmaes.each.attachment=["broad", "short"]',
    )  # fmt: skip
    run = measure(tmp_path, "fire-attachment", small)
    words, result = words_of(page_of(run)), stored_result(run)
    for winner in result.winners:
        value, interval = interval_words(winner.value, winner.ci95, winner.unit)
        assert f"{winner.parameters['attachment']} {value} {interval} 3" in words
    for verdict in result.verdicts:
        assert f"attachment = {verdict.level['attachment']}: budget spent: 2 generations" in words


def test_a_run_that_did_not_search_says_nothing_of_how_a_search_ended(page):
    assert "How the search ended" not in page
