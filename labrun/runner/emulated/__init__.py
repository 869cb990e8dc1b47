"""`--emulate`: the real drivers in real time, against emulators of their devices in front of one simulated bench."""
