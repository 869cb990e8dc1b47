"""Strips and hinges that are pulled in a tensile tester (sections 2.1 and 3.1 of the source work)."""
