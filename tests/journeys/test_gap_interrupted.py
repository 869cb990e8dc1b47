"""A diagnosis that is stopped, by Ctrl-C or by its time limit, ends with the best answer so far."""

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from swings import MODEL, swing

_SEARCHES = "candidates "
"""Part of the notes of a search for causes."""


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a recording of swings that rub, long enough that its diagnosis takes a while."""
    folder, rng = tmp_path / "swings", np.random.default_rng(0)
    folder.mkdir()
    (folder / "model.toml").write_text(MODEL)
    toml = ["[channels.angle]", 'kind = "output"', 'unit = "rad"']
    for release in (0.3, 0.45, 0.6, 0.75, 0.9, 1.05):
        time_s, angle = swing(
            release, duration_s=6.0, rate_hz=120.0, extra=lambda _, rate: -6e-4 * float(np.tanh(rate / 0.02))
        )
        seen = angle + 1e-3 * rng.standard_normal(len(angle))
        rows = [f"{t:.6f},{value:.6f}" for t, value in zip(time_s, seen, strict=True)]
        (folder / f"{release}.csv").write_text("\n".join(["time_s,angle", *rows]))
        toml += ["[[trials]]", f'file = "{release}.csv"', f"condition = {{ release_rad = {release} }}"]
    (folder / "recording.toml").write_text("\n".join(toml))
    return folder


def is_searching(folder: Path) -> bool:
    """Tell whether the log file of a diagnosis says that it looks for causes."""
    logs = folder.glob("results/swings/gap-*-progress.log")
    return any(_SEARCHES in log.read_text() for log in logs)


def test_ctrl_c_in_the_search_prints_the_best_answer_so_far_and_keeps_it(
    command: list[str], recording: Path
) -> None:
    folder = recording.parent
    with subprocess.Popen(
        [*command, "gap", "diagnose", "swings", "--json", "--no-report"],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509 - one thread
    ) as process:
        while process.poll() is None and not is_searching(folder):
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    answer = json.loads(out)
    assert (answer["complete"], answer["stopped"]) == (False, "interrupted")
    assert [rung["step"] for rung in answer["ladder"]][:2] == ["as stated", "recalibrated"]
    assert json.loads(Path(folder / answer["stored"]).read_text())["stopped"] == "interrupted"


def test_a_time_limit_ends_with_an_answer_that_says_so(labrun, recording: Path) -> None:
    done = labrun("gap", "diagnose", recording, "--within", "1s", "--no-report")
    assert done.code == 0, done.err
    assert "Stopped early: this is the best answer so far." in done.out
