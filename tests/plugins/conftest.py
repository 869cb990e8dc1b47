"""Makes `emulated`, which stands beside it, importable by the tests of every device."""
