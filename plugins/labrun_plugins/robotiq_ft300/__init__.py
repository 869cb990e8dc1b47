"""The Robotiq FT300 and FT300-S force/torque sensors: Modbus RTU and their 100 Hz stream."""
