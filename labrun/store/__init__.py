"""Runs on disk: the run folder, a trial's file, ``run.h5``, recordings made elsewhere, and what follows a run."""

from labrun.store._recording_toml import Between
from labrun.store.disk import lacking_room, replace_durably, require_writable, saving
from labrun.store.export import export_run
from labrun.store.folder import RunFolder
from labrun.store.frames import run_dataset, trial_dataset, trials_frame
from labrun.store.importing import import_recording
from labrun.store.journal import Journal, remarks_of
from labrun.store.locate import (
    JOURNAL,
    PACKED,
    PROVENANCE,
    SPEC,
    TRIALS,
    all_runs,
    find_run,
    find_unfinished,
    is_finished,
)
from labrun.store.locks import lock_ports
from labrun.store.provenance import collect
from labrun.store.reading import Run, open_run, open_target
from labrun.store.recording import (
    RecordedTrial,
    Recording,
    SignalInfo,
    imported_channels,
    imported_source,
    is_recording,
    read_recording,
)
from labrun.store.table import known_units
from labrun.store.timing import JUMP_S, StreamReport, stream_report
from labrun.store.trial import (
    Role,
    SettleSummary,
    Status,
    TrialOutcome,
    json_ready,
    mean_truncation,
    settle_curve,
)
from labrun.store.trial_file import COMMAND, check_columns, check_names
from labrun.store.watching import RunWatch, Trace, read_trace
from labrun.store.writer import TrialWriter, dated, tare_of, undated

__all__ = [
    "COMMAND", "JOURNAL", "JUMP_S", "PACKED", "PROVENANCE", "SPEC", "TRIALS", "Between", "Journal",
    "RecordedTrial", "Recording", "Role", "Run", "RunFolder", "RunWatch", "SettleSummary", "SignalInfo",
    "Status", "StreamReport", "Trace", "TrialOutcome", "TrialWriter", "all_runs", "check_columns",
    "check_names", "collect", "dated", "export_run", "find_run", "find_unfinished", "import_recording",
    "imported_channels", "imported_source", "is_finished", "is_recording", "json_ready", "known_units",
    "lacking_room", "lock_ports", "mean_truncation", "open_run", "open_target", "read_recording", "read_trace",
    "remarks_of", "replace_durably", "require_writable", "run_dataset", "saving", "settle_curve",
    "stream_report", "tare_of", "trial_dataset", "trials_frame", "undated",
]  # fmt: skip
