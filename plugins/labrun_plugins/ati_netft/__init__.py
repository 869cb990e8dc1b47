"""ATI force/torque sensors on a Net F/T box, over the network."""
