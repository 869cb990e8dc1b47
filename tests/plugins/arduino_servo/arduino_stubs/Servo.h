// The servo library, as far as a sketch can see it.
#pragma once
#include <Arduino.h>

struct Servo {
  int pin = -1;
  int pulse_us = 0;
  uint8_t attach(int on, int, int) {
    pin = on;
    return 0;
  }
  void detach() { pin = -1; }
  void writeMicroseconds(int us) { pulse_us = us; }
};
