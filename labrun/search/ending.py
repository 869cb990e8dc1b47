"""How a run ends early: journalled, with what was saved and the line to go on with."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from labrun.errors import LabrunError, PlanError
from labrun.search.result import resume_line

if TYPE_CHECKING:
    from labrun.store.folder import RunFolder


@contextmanager
def resumable(folder: "RunFolder") -> Iterator[None]:
    """Journal why a run ended early, and tell the person how to go on."""
    from labrun.runner.faults import Interrupted

    try:
        yield
    except KeyboardInterrupt as interrupt:  # between two measurements; during one the session sees to it
        _journal_end(folder, "interrupted", "Ctrl-C")
        message = f"interrupted by Ctrl-C: actuators are stopped, {_saved(folder)}"
        stopped = Interrupted(message, hint=_go_on(folder))
        stopped.details.update(_so_far(folder))
        raise stopped from interrupt
    except LabrunError as error:
        _journal_end(folder, "interrupted" if isinstance(error, Interrupted) else "failed", str(error))
        saved = _saved(folder) if isinstance(error, PlanError) else f"{_saved(folder)}; {_go_on(folder)}"
        error.hint = saved if error.hint is None else f"{error.hint}\n  {saved}"
        error.details.update(_so_far(folder))
        raise
    except Exception as error:
        _journal_end(folder, "failed", f"{type(error).__name__}: {error}")
        error.add_note(f"{_saved(folder)}; {_go_on(folder)}")
        raise


def _go_on(folder: "RunFolder") -> str:
    return f"to go on: {resume_line(folder.path)}"


def _journal_end(folder: "RunFolder", event: str, reason: str) -> None:
    try:
        folder.journal.append(event, reason=reason)
    except (OSError, LabrunError):  # a full disk: the error that brought us here tells more
        return


def _saved(folder: "RunFolder") -> str:
    try:
        count = len(folder.outcomes())
    except (OSError, LabrunError):
        return f"what was measured is kept in {folder.path}"
    return f"{count} trials are kept in {folder.path}"


def _so_far(folder: "RunFolder") -> dict[str, Any]:
    """Return where the data are and what was done, for scripts."""
    try:
        statuses = [outcome.status for outcome in folder.outcomes().values()]
    except (OSError, LabrunError):
        return {"run": str(folder.path)}
    trials = {status: statuses.count(status) for status in ("done", "rejected", "failed")}
    return {"run": str(folder.path), "trials": trials}


@contextmanager
def terminate_like_interrupt() -> Iterator[None]:
    """Let SIGTERM (a shutdown, a batch system) end a run as Ctrl-C does: actuators first, then the data."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(_signal: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
