"""RC servos on an Arduino that runs the firmware `labservo`."""
