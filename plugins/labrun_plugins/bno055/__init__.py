"""The Bosch BNO055 inertial measurement unit on its serial line (UART)."""
