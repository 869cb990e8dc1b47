// The sketch on the host: a screw, two end switches and an HX711 around it, in simulated time.
//
// Reads from standard input, one command a line:  F <text> feeds a line to the board;  T <ms> lets time pass;
// P <steps> puts the screw somewhere;  C <counts> and K <counts per step> make the load cell read
// C + K * (true position - position at K);  D 0|1 takes the load cell away;  U <us> moves the board's microseconds on.
// Writes what the board sends, and "@ <true position, steps>" after every T.
#include <cstdint>
#include <cstdio>
#include <iostream>
#include <sstream>
#include <string>

#define HIGH 1
#define LOW 0
#define INPUT 0
#define OUTPUT 1
#define INPUT_PULLUP 2
#define FALLING 2

static uint64_t nowUs = 0, offsetUs = 0;
static int64_t truePosition = 48000, felt = 0;
static double perStep = 0;
static int64_t baseCounts = 0;
static bool present = true, dataLow = false, stepLevel = false, dirLevel = false, clockLevel = false;
static uint32_t shift = 0;
static int pulses = 0;
static void (*onEdge)() = nullptr;
static std::string received, sent;
static const int64_t TOP_STEPS = 96000;  // 60 mm

uint32_t micros() { return (uint32_t)(nowUs + offsetUs); }
uint32_t millis() { return (uint32_t)(nowUs / 1000); }
void noInterrupts() {}
void interrupts() {}
void pinMode(uint8_t, uint8_t) {}
int digitalPinToInterrupt(uint8_t pin) { return pin; }
void attachInterrupt(int, void (*call)(), int) { onEdge = call; }

int digitalRead(uint8_t pin) {
  if (pin == 8) return truePosition <= 0 ? HIGH : LOW;
  if (pin == 9) return truePosition >= TOP_STEPS ? HIGH : LOW;
  if (pin == 2) return pulses > 0 && pulses <= 24 ? (shift >> 24) & 1 : !dataLow;
  return LOW;
}

void digitalWrite(uint8_t pin, int level) {
  if (pin == 6) dirLevel = level;
  if (pin == 5) {
    if (level && !stepLevel) truePosition += dirLevel ? 1 : -1;
    stepLevel = level;
  }
  if (pin == 4) {
    if (level && !clockLevel) {
      pulses++;
      shift <<= 1;
      if (pulses >= 25) { dataLow = false; pulses = 0; }
    }
    clockLevel = level;
  }
}

struct Port {
  void begin(long) {}
  int available() { return (int)received.size(); }
  int read() { const char one = received[0]; received.erase(0, 1); return one; }
  int availableForWrite() { return 63; }
  void write(char one) { sent += one; }
} Serial;

#include SKETCH

static void convertNow() {
  if (!present) return;
  int64_t reading = baseCounts + (int64_t)(perStep * (double)(truePosition - felt));
  if (reading > 0x7FFFFF) reading = 0x7FFFFF;
  if (reading < -0x800000) reading = -0x800000;
  shift = (uint32_t)(reading & 0xFFFFFF);
  pulses = 0;
  dataLow = true;
  if (onEdge) onEdge();
}

int main() {
  setup();
  std::string command;
  while (std::getline(std::cin, command)) {
    std::istringstream words(command);
    char what;
    words >> what;
    if (what == 'F') {
      received += command.substr(2) + "\n";
    } else if (what == 'P') {
      words >> truePosition;
    } else if (what == 'C') {
      words >> baseCounts;
    } else if (what == 'K') {
      words >> perStep;
      felt = truePosition;
    } else if (what == 'D') {
      words >> present;
    } else if (what == 'U') {
      words >> offsetUs;
    } else if (what == 'T') {
      uint64_t ms;
      words >> ms;
      for (const uint64_t end = nowUs + 1000 * ms; nowUs < end;) {
        nowUs += 40;
        tick();
        if (nowUs % 12500 < 40) convertNow();
        if (nowUs % 200 == 0) loop();
      }
      std::cout << sent << "@ " << truePosition << "\n";
      sent.clear();
    }
  }
  return 0;
}
