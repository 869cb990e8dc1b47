"""Use cases, one a file: the only place that composes packages. These functions are the Python API, too."""
