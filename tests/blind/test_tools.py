"""Another program in place of the diagnosis: what it is handed, and what becomes of what it prints."""

import json
import os
import sys
import time
from pathlib import Path

import pytest

from labrun.blind.judging import Reply
from labrun.blind.tool import Tool, ask_tool, tools_of
from labrun.errors import RequestError

FILES = {"recording.toml": b'experiment = "x"\n', "trial001.csv": b"time_s\n", "model.toml": b""}


def script(folder: Path, body: str) -> Tool:
    path = folder / "method.py"
    path.write_text(f"import json, sys, time\nfrom pathlib import Path\n{body}\n")
    return Tool("method", (sys.executable, str(path)), 20.0)


def reason(tool: Tool) -> str:
    reply = Reply.of_tool(ask_tool(tool, "case-0001", FILES))
    assert reply.answer is None
    return reply.reason


def test_a_tool_is_handed_a_folder_with_the_files_of_the_case_and_nothing_else(tmp_path: Path) -> None:
    body = """
folder = Path(sys.argv[-1])
site = ",".join(sorted(path.name for path in folder.parent.glob("case*/*")))
print(json.dumps({"gap": True, "causes": [{"effect": folder.name, "site": site}], "rest": 0.25}))"""
    reply = Reply.of_tool(ask_tool(script(tmp_path, body), "case-0007", FILES))
    assert reply.answer is not None
    assert str(reply.answer.causes[0]) == "case-0007 at model.toml,recording.toml,trial001.csv"
    assert reply.answer.rest == 0.25
    assert reply.processor_s > 0


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("sys.exit('no convergence')", "ended with exit code 1: no convergence"),
        ("pass", "printed nothing on standard output"),
        ("print('friction, I think')", "not one JSON object"),
        ("print('[1, 2]')", "printed list, not a JSON object"),
        ('print(\'{"gap": true, "causes": [], "rest": NaN}\')', "NaN is not a JSON number"),
        ("print('{\"gap\": true}')", "causes: field required"),
        ("import os; os.abort()", "ended by signal 6"),
    ],
)
def test_a_tool_that_fails_or_prints_nonsense_gives_no_answer_and_the_reason(
    tmp_path: Path, body: str, words: str
) -> None:
    assert words in reason(script(tmp_path, body))


def test_a_tool_over_its_time_is_stopped_with_all_that_it_started(tmp_path: Path) -> None:
    body = f"""
import subprocess
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
Path({str(tmp_path / "child")!r}).write_text(str(child.pid))
time.sleep(60)"""
    tool = script(tmp_path, body)
    assert reason(Tool(tool.name, tool.command, 1.5)) == "not finished within 1.5 s"
    child = int((tmp_path / "child").read_text())
    for _ in range(100):
        if not _runs(child):
            return
        time.sleep(0.05)
    raise AssertionError("the child of the tool still runs")


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{pid}/stat")  # a zombie that init has not reaped yet has ended
    return not status.exists() or status.read_text().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.parametrize(
    ("command", "words"),
    [("", "is empty"), ("python 'x", "cannot be split"), ("no-such-program-here x", "does not exist")],
)
def test_a_command_that_cannot_run_is_refused_before_anything_is_made(command: str, words: str) -> None:
    with pytest.raises(RequestError, match=words):
        tools_of([command])


def test_a_limit_without_any_time_is_refused() -> None:
    with pytest.raises(RequestError, match="no time"):
        tools_of(["true"], 0.0)


def test_tools_are_named_by_their_scripts_and_never_alike(tmp_path: Path) -> None:
    path = script(tmp_path, "").command[1]
    names = [
        tool.name
        for tool in tools_of([f"{sys.executable} {path} --fast", f"{sys.executable} {path}", "true"])
    ]
    assert names == ["method", "method-2", "true"]


def test_an_edited_script_has_another_fingerprint(tmp_path: Path) -> None:
    tool = script(tmp_path, "print(1)")
    before = tool.fingerprint
    assert tool.fingerprint == before
    script(tmp_path, "print(2)")
    assert tool.fingerprint != before


def test_what_a_tool_printed_can_be_kept_as_json(tmp_path: Path) -> None:
    body = "print(json.dumps({'gap': False, 'causes': [], 'note': 'quiet'}))"
    kept = json.loads(json.dumps(ask_tool(script(tmp_path, body), "case-0001", FILES), allow_nan=False))
    assert Reply.of_tool(kept).answer is not None
