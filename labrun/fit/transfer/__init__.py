"""Linear models of one input and one output: transfer functions with a dead time, fitted and simulated exactly."""
