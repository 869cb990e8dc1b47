"""ATI force/torque sensors on a data acquisition card: six voltages and a calibration matrix."""
