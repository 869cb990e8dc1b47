"""`python -m labrun`."""

from labrun.cli import main

main()
