"""What a command does where its output cannot be written."""

import subprocess
from pathlib import Path

import pytest
from forked_labrun import forked_programs

FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="this system has no device that is always full")
@pytest.mark.parametrize(
    "arguments",
    [
        ["list"],
        ["list", "--json"],
        ["keys", "trial"],
        ["plugins"],
        ["check", "hinge"],
        ["--version"],
        ["--help"],
    ],
    ids=" ".join,
)
def test_standard_output_on_a_full_disk_is_told_in_one_sentence(arguments, tmp_path):
    with FULL.open("w") as full:
        done = subprocess.run(
            [forked_programs() / "labrun", *arguments],
            cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.startswith("labrun: standard output cannot be written: No space left on device\n")
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not FULL.exists(), reason="this system has no device that is always full")
def test_a_run_whose_result_cannot_be_printed_is_finished_and_kept(tmp_path):
    with FULL.open("w") as full:
        done = subprocess.run(
            [forked_programs() / "labrun", "run", "hinge", "--dry-run", "--set", "trial.repeats=1"],
            cwd=tmp_path, stdout=full, stderr=full, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert len(list(tmp_path.glob("results/hinge/*/run.h5"))) == 1
    assert '"finished"' in next(tmp_path.glob("results/hinge/*/journal.jsonl")).read_text()


@pytest.mark.parametrize("closed", ["stdout", "stderr"])
def test_a_closed_stream_keeps_no_command_from_ending_well(closed, tmp_path):
    script = f'exec "$0" list {"1" if closed == "stdout" else "2"}>&-'
    done = subprocess.run(
        ["sh", "-c", script, forked_programs() / "labrun"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Traceback" not in done.stderr
