"""A body between pegs whose arm buckles to one side (section 7.1 of the source work)."""
