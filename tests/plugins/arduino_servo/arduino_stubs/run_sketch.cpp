// Runs a sketch by orders from standard input, one a line: "B <hex>" bytes arrive, "T <ms>" time passes (a loop each
// millisecond), "A <n>" the analogue input reads n,
// "S <bits>" these pins are connected to ground, "P" tells each channel's pin and pulse, "W" the chip's watchdog.
// Answers each order with one line: what the sketch has sent since, in hexadecimal, or what was asked.
#include <Arduino.h>
#include <iostream>

uint8_t MCUSR;
uint32_t stub_millis, stub_closed;
int stub_analog, stub_wdt = -1, stub_wdt_resets;
StubSerial Serial;

#include SKETCH

static std::string sent() {
  static const char *digits = "0123456789abcdef";
  std::string hex;
  for (unsigned char byte : Serial.out) {
    hex += digits[byte >> 4];
    hex += digits[byte & 15];
  }
  Serial.out.clear();
  return hex;
}

static void run() {
  for (int i = 0; i < 4; i++) loop();  // what is queued needs more than one turn to leave
}

int main() {
  setup();
  run();
  std::string order, argument;
  std::cout << sent() << std::endl;
  while (std::cin >> order) {
    if (order == "B") {
      std::cin >> argument;
      for (size_t i = 0; i + 1 < argument.size(); i += 2) Serial.in.push_back((uint8_t)std::stoi(argument.substr(i, 2), nullptr, 16));
      run();
      std::cout << sent() << std::endl;
    } else if (order == "T") {
      unsigned long ms;
      std::cin >> ms;
      while (ms--) {
        stub_millis++;
        run();
      }
      std::cout << sent() << std::endl;
    } else if (order == "S") {
      std::cin >> stub_closed;
      std::cout << std::endl;
    } else if (order == "A") {
      std::cin >> stub_analog;
      std::cout << std::endl;
    } else if (order == "P") {
      for (const Channel &channel : channels) std::cout << channel.servo.pin << ":" << channel.servo.pulse_us << " ";
      std::cout << std::endl;
    } else if (order == "W") {
      std::cout << stub_wdt << " " << stub_wdt_resets << std::endl;
    }
  }
}
