"""Ways of fitting, one plugin a module: what `labrun fit` can do with recorded data."""
