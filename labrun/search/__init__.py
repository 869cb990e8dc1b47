"""Which trials come next: sweeps, CMA-ES, the honest best; and whole runs from plan to picture."""
