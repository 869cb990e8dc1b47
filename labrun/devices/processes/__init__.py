"""What runs beside the runner, each in a process of its own: the watchdog, the simulated bench, an emulator."""
