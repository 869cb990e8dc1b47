// Just enough of the Arduino core to run a sketch on a PC, with a clock and a serial port that the test holds.
#pragma once
#include <cstdint>
#include <cstring>
#include <deque>
#include <string>

template <class A, class B, class C>
auto constrain(A value, B low, C high) -> decltype(value + low + high) {
  return value < low ? low : value > high ? high : value;
}

extern uint8_t MCUSR;
extern uint32_t stub_millis;
extern int stub_analog;
inline uint32_t millis() { return stub_millis; }
inline int analogRead(int) { return stub_analog; }
enum { LOW, HIGH, INPUT_PULLUP };
extern uint32_t stub_closed;  // a bit for each pin: 1 where it is connected to ground
inline void pinMode(int, int) {}
inline int digitalRead(int pin) { return (stub_closed >> pin) & 1 ? LOW : HIGH; }

struct StubSerial {
  std::deque<uint8_t> in;
  std::string out;
  void begin(unsigned long) {}
  int available() { return (int)in.size(); }
  int read() {
    if (in.empty()) return -1;
    int byte = in.front();
    in.pop_front();
    return byte;
  }
  int availableForWrite() { return 63; }
  size_t write(const uint8_t *data, size_t count) {
    out.append((const char *)data, count);
    return count;
  }
};
extern StubSerial Serial;
