"""Hinges that are turned to and fro until they tear (section 2.1 of the source work)."""
