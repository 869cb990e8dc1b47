"""The device plugins that come with labrun, one folder each."""
