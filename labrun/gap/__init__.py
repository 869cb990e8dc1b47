"""Where a model and measurements differ, which unmodelled effect causes it, and how far adding it closes the gap."""
