"""The experiment file: its tables, its reader, and its checks."""

from labrun.experiment.condition import (
    Condition,
    Value,
    condition_key,
    condition_text,
    only,
    value_text,
    varying,
)
from labrun.experiment.experiment import (
    Experiment,
    FitTable,
    GaitTable,
    GapTable,
    ObjectiveTable,
    RigTable,
    SceneTable,
)
from labrun.experiment.key_reference import Key, keys_at
from labrun.experiment.loading import (
    LoadedExperiment,
    apply_overrides,
    find_beside,
    load_experiment,
    load_named,
    loads_experiment,
    resolved,
)
from labrun.experiment.loop_tables import (
    LOOP_DEVICE,
    TIMING_CHANNELS,
    LoopShape,
    LoopTable,
    Track,
    loop_channel,
)
from labrun.experiment.plugins import resolved_settings, scene_of
from labrun.experiment.raw import named_channels
from labrun.experiment.search_tables import (
    BRACES,
    SIMULATION,
    SUMMARIES,
    CmaEs,
    Combine,
    Design,
    DesignVariable,
    DrawnPart,
    Guard,
    Interval,
    Leaders,
    LeadersOf,
    Penalty,
    Range,
    RunTable,
    SearchVariable,
    StopRules,
    Sweep,
    WrittenExperiment,
)
from labrun.experiment.specimens import BROKEN, PAST, ByHand, DamageTable
from labrun.experiment.template import new_experiment
from labrun.experiment.trial_tables import (
    CYCLES,
    Averaging,
    CarriageMove,
    Criterion,
    CyclesOf,
    Follow,
    Outliers,
    ReferenceTable,
    RepeatRule,
    Settle,
    Tare,
    TrialTable,
    Until,
)
from labrun.experiment.workspace import (
    create_workspace,
    find_experiment,
    find_model_file,
    list_experiments,
    shipped_experiments,
    summarise_workspace,
)

__all__ = [
    "BRACES", "BROKEN", "CYCLES", "LOOP_DEVICE", "PAST", "SIMULATION", "SUMMARIES", "TIMING_CHANNELS",
    "Averaging", "ByHand", "CarriageMove", "CmaEs", "Combine", "Condition", "Criterion", "CyclesOf",
    "DamageTable", "Design", "DesignVariable", "DrawnPart", "Experiment", "FitTable", "Follow",
    "GaitTable", "GapTable", "Guard", "Interval", "Key", "Leaders", "LeadersOf", "LoadedExperiment",
    "LoopShape", "LoopTable", "ObjectiveTable", "Outliers", "Penalty", "Range", "ReferenceTable",
    "RepeatRule", "RigTable", "RunTable", "SceneTable", "SearchVariable", "Settle", "StopRules", "Sweep",
    "Tare", "Track", "TrialTable", "Until", "Value", "WrittenExperiment", "apply_overrides",
    "condition_key", "condition_text", "create_workspace", "find_beside", "find_experiment",
    "find_model_file", "keys_at", "list_experiments", "load_experiment", "load_named", "loads_experiment",
    "loop_channel", "named_channels", "new_experiment", "only", "resolved", "resolved_settings",
    "scene_of", "shipped_experiments", "summarise_workspace", "value_text", "varying",
]  # fmt: skip
