import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from memory_run import MemoryRun, sweep_view
from rich.console import Console

from labrun.app.report import read_findings
from labrun.errors import SpecError
from labrun.experiment import loads_experiment
from labrun.report.data import RunView
from labrun.report.live import LiveProgress
from labrun.report.statistics import drift, repeatability
from labrun.report.terminal import print_findings
from labrun.report.timing import stream_health
from labrun.store import RunFolder, TrialOutcome, open_run


class OwnClock(MemoryRun):
    """Its device's clock is 12 s ahead and 50 ppm slow."""

    def signals(self, index):
        stream = super().signals(index)["wrench"]
        host_time_s = stream.host_time_s + 60.0 * index
        device_time_s = (host_time_s + 12.0) * (1 - 50e-6)
        return {"wrench": replace(stream, device_time_s=device_time_s, host_time_s=host_time_s)}


def with_references(slope_per_h, noise, seed, count=30):
    view = sweep_view(lambda c: 0.0, {"f": [1]})
    rng = np.random.default_rng(seed)
    trials = [
        TrialOutcome(k, {"f": 1.0}, 0, "reference", started_s=600.0 * k,
                     objectives={"thrust": 0.5 + slope_per_h * k / 6 + noise * rng.standard_normal()})
        for k in range(count)
    ]  # fmt: skip
    streams = MemoryRun([replace(trial, duration_s=1.0) for trial in trials])
    return replace(view, run=streams)


def test_the_interval_of_the_drift_covers_the_truth_95_percent_of_the_time():
    covered = 0
    for seed in range(400):
        (fitted,) = drift(with_references(0.02, 0.05, seed))
        covered += fitted.ci95[0] <= 0.02 <= fitted.ci95[1]
    assert covered / 400 == pytest.approx(0.95, abs=0.045)


def test_a_strong_drift_is_visible_and_none_is_not():
    assert drift(with_references(0.1, 0.01, 1))[0].visible
    assert not drift(with_references(0.0, 0.05, 1))[0].visible


def test_two_references_are_too_few_to_speak_of_drift():
    assert drift(with_references(0.1, 0.01, 1, count=2)) == []


def test_repeatability_is_the_spread_within_conditions_whatever_lies_between_them():
    view = sweep_view(lambda c: 10 * c["f"], {"f": list(range(40))}, noise=0.05, repeats=5)
    (repeats,) = repeatability(view)
    assert repeats.sd == pytest.approx(0.05, rel=0.15)
    assert repeats.between_sd == pytest.approx(10 * np.std(np.arange(40), ddof=1), rel=0.05)
    assert repeats.unit == "N"


def test_without_repeats_nothing_is_said_of_repeatability():
    view = sweep_view(lambda c: 0.0, {"f": [1, 2, 3]}, repeats=1)
    only_measured = MemoryRun([o for o in view.run.outcomes if o.role == "measure"])
    assert repeatability(RunView(only_measured, view.experiment, None)) == []


def test_streams_are_reported_with_rate_jitter_and_losses():
    view = sweep_view(lambda c: 0.0, {"f": [1, 2]}, repeats=1)
    run = MemoryRun(view.run.outcomes, lost=3)
    (health,) = stream_health(RunView(run, view.experiment, None), [0, 1])
    assert health.device == "wrench"
    assert health.actual_hz == pytest.approx(100.0)
    assert health.jitter_s == pytest.approx(0.0, abs=1e-9)
    assert health.lost == 6
    assert health.lost_share == pytest.approx(6 / (health.samples + 6))
    assert (health.clock_offset_s, health.clock_drift_ppm) == (0.0, None)


def test_a_clock_is_reported_with_its_offset_and_the_drift_from_trial_to_trial():
    view = sweep_view(lambda c: 0.0, {"f": [1, 2]}, repeats=3)

    (health,) = stream_health(RunView(OwnClock(view.run.outcomes), view.experiment, None), range(6))
    assert health.clock_offset_s == pytest.approx(-12.0, abs=0.02)
    assert health.clock_drift_ppm == pytest.approx(50, abs=1)
    assert health.glitches == 0


def test_a_stored_run_is_read_where_its_plugins_are_not_installed(tmp_path):
    text = tomli_w.dumps(
        sweep_view(lambda c: 0.0, {"f": [1]}).experiment.model_dump(by_alias=True, exclude_none=True)
    )
    text = text.replace('"cycle-mean"', '"gone:Mean"').replace('"robotiq-ft300"', '"gone:Wrench"')
    text = text.replace('"sine"', '"gone:Sine"')
    folder = RunFolder.create(tmp_path, "fin", text, {"seed": 1})
    for index in range(3):
        folder.writer(index).finish(
            TrialOutcome(index, {"f": 1.0}, index, objectives={"thrust": 1.0 + index}), None, None
        )
    findings = read_findings(open_run(folder.path))
    assert findings.repeatability[0].sd == pytest.approx(1.0)
    assert findings.repeatability[0].unit == ""
    with pytest.raises(SpecError, match="gone"):
        loads_experiment(text, "fin")


def printed(findings, width=120):
    console = Console(file=io.StringIO(), width=width)
    print_findings(findings, console)
    return console.file.getvalue()


def test_findings_print_everything_one_asks_of_a_run():
    view = with_references(0.1, 0.01, 1)
    rejected = [replace(view.run.outcomes[0], index=30, role="measure", status="rejected", reason="outlier")]
    swept = sweep_view(lambda c: c["f"], {"f": [1, 2]})
    findings = replace(swept, run=MemoryRun([*view.run.outcomes, *rejected, *swept.run.outcomes]))
    text = printed(findings)
    for expected in ("Thrust", "95 % interval", "luckiest", "rejected: outlier", "drifts", "quiet", "wrench"):
        assert expected in text


def test_clocks_of_simulated_streams_are_made_up_and_not_printed():
    view = sweep_view(lambda c: c["f"], {"f": [1, 2]})
    text = printed(replace(view, run=OwnClock(view.run.outcomes)), 80)
    assert "streams" in text
    assert "offset" not in text
    assert "ppm" not in text


def test_clocks_of_the_streams_are_printed_whole_in_80_columns():
    view = sweep_view(lambda c: c["f"], {"f": [1, 2]})
    measured = OwnClock(view.run.outcomes, lost=12, provenance={"seed": 1})
    text = printed(replace(view, run=measured), 80)
    (row,) = [line for line in text.splitlines() if line.strip().startswith("wrench")]
    assert re.search(r" -?[\d.]+ s ", row)
    assert re.search(r" -?[\d.]+ ppm ", row)
    assert "…" not in text


def test_findings_are_json_without_holes():
    view = replace(with_references(0.1, 0.01, 1), finished=True)
    text = json.dumps(view.to_json(), allow_nan=False)
    assert json.loads(text)["drift"][0]["objective"] == "thrust"


def test_a_run_that_is_not_finished_says_how_to_go_on(tmp_path):
    view = sweep_view(lambda c: c["f"], {"f": [1, 2]})
    run = MemoryRun(view.run.outcomes, path=tmp_path)
    assert f"labrun resume {tmp_path}" in printed(replace(view, run=run, finished=False), 200)


def drive(progress):
    with progress:
        progress.total(10)
        progress.phase("record")
        progress.trial(TrialOutcome(0, {"f": 1.4}, 0, objectives={"thrust": 0.31}), 1, 10, 754.0)
        progress.best({"f": 1.4}, 0.31, "N")
        progress.note("reference drifts")
        console = progress._console
        with console.capture() as capture:
            console.print(progress._render())
    return capture.get()


def test_the_live_display_shows_what_happens_now_trials_time_left_and_the_best_so_far():
    text = drive(LiveProgress(Console(file=io.StringIO(), force_terminal=True, width=120, color_system=None)))
    for expected in ("record", "1/10", "12 min 34 s left", "best so far", "0.31 N", "f = 1.4"):
        assert expected in text


def test_the_live_display_is_quiet_where_nobody_watches():
    console = Console(file=io.StringIO(), force_terminal=False)
    drive(LiveProgress(console))
    assert console.file.getvalue() == ""
