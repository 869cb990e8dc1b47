"""When a condition has been measured often enough."""

from labrun.runner.measurement import Measurement
from labrun.spec import RepeatRule


def needs_another(measurement: Measurement, rule: RepeatRule) -> bool:
    """Tell whether a condition needs another repeat.

    At least `rule.min` accepted trials, then more until every standard error named is small enough, at most
    `rule.max`. A rejected or failed trial is replaced; after `rule.max` replacements the condition is left as it is,
    so that a condition that always fails cannot hold the run for ever.
    """
    accepted = len(measurement.accepted)
    if accepted >= rule.max or len(measurement.outcomes) - accepted > rule.max:
        return False
    if accepted < rule.min:
        return True
    return any(measurement.standard_error(name) > bound for name, bound in rule.standard_error.items())
