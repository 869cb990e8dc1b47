"""The stand-in devices of a dry run, and the simulated benches they look at (`scenes`)."""
