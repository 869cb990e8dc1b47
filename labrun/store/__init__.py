"""Runs on disk: the run folder, a trial's file, ``run.h5``, recordings made elsewhere, and what follows a run."""

from labrun.store.disk import in_bytes, lacking_room, lock_ports, replace_durably, require_writable, saving
from labrun.store.export import export_run, run_dataset, trial_dataset, trials_frame
from labrun.store.folder import RunFolder
from labrun.store.journal import Journal, collect, remarks_of
from labrun.store.locate import (
    JOURNAL,
    PACKED,
    PROVENANCE,
    SPEC,
    TRIALS,
    all_runs,
    find_data,
    find_run,
    find_unfinished,
    is_finished,
)
from labrun.store.reading import Run, import_recording, open_run, open_target
from labrun.store.recording import (
    Between,
    RecordedTrial,
    Recording,
    SignalInfo,
    imported_channels,
    imported_source,
    is_recording,
    read_recording,
    recording_name,
)
from labrun.store.timing import JUMP_S, StreamReport, stream_report
from labrun.store.trial import (
    Role,
    SettleSummary,
    Status,
    TrialOutcome,
    json_ready,
    known_units,
    mean_truncation,
    settle_curve,
)
from labrun.store.trial_file import COMMAND, TrialWriter, check_columns, check_names, dated, tare_of, undated
from labrun.store.watching import RunWatch, Trace, read_trace

__all__ = [
    "COMMAND", "JOURNAL", "JUMP_S", "PACKED", "PROVENANCE", "SPEC", "TRIALS", "Between", "Journal",
    "RecordedTrial", "Recording", "Role", "Run", "RunFolder", "RunWatch", "SettleSummary", "SignalInfo",
    "Status", "StreamReport", "Trace", "TrialOutcome", "TrialWriter", "all_runs", "check_columns",
    "check_names", "collect", "dated", "export_run", "find_data", "find_run", "find_unfinished", "import_recording",
    "imported_channels", "imported_source", "in_bytes", "is_finished", "is_recording", "json_ready", "known_units",
    "lacking_room", "lock_ports", "mean_truncation", "open_run", "open_target", "read_recording", "read_trace",
    "recording_name", "remarks_of", "replace_durably", "require_writable", "run_dataset", "saving", "settle_curve",
    "stream_report", "tare_of", "trial_dataset", "trials_frame", "undated",
]  # fmt: skip
