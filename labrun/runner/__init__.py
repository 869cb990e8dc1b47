"""From plan to trials: prepare, settle, tare, record, safe pose, and only then store."""
