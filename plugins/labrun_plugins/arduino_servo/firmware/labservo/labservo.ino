// labservo: RC servos behind labline v1, for AVR boards such as Uno, Nano, Leonardo and Mega.
//
// 115 200 8N1, one ASCII line a message:   $<seq>,<word>[,<arg>...]*<CRC4>\n
// CRC-16/CCITT-FALSE (polynomial 1021, start FFFF) over what stands between $ and *, four upper-case hexadecimal digits.
//
//   HELLO                    OK,HELLO,<kind>,<firmware>,<channels>,<set-points/s>
//   WD,<ms>                  OK,WD,<ms>      20 ... 5000 arms the watchdog, 0 turns it off (not while moving)
//   ATT,<ch>,<min>,<max>     OK,ATT          pulses begin, within these limits, us
//   SV,<us0>,<us1>,...       OK,SV           a pulse width for every channel, -1 leaves it; a channel that is not
//                                            attached keeps it for its first pulse
//   DET,<ch>                 OK,DET          pulses end
//   STOP                     OK,STOP         the safe state
//   ST                       OK,ST,<state>,<us0>,...,<millis>   0 at rest, 1 moving, 2 watchdog expired, 3 hardware
//   SW                       OK,SW,<s0>,...  switches: 1 closed (to ground), 0 open; none without SWITCH_PINS
//   PING                     OK,PING
//
// ERR,WORD  ERR,ARGC  ERR,RANGE,<channel or argument>  ERR,STATE  ERR,WDOG  ERR,HW,<what>
// 0,EV,BOOT,<firmware>   0,EV,WDOG   0,EV,HW,OVERCURRENT
//
// Nothing moves while the watchdog is off. Any line with a good checksum feeds it; when it expires, the safe state is
// taken, and motion is refused until WD is sent again. A second watchdog, the chip's own, resets a hanging firmware:
// its outputs are off then. Loops never wait.

#include <Arduino.h>
#include <Servo.h>
#include <avr/wdt.h>

// ---- what you may change -------------------------------------------------------------------------------------------

#ifndef KIND
#define KIND "labservo"  // "labreset" on the board of a carriage-reset, "labslider" on that of a tendon-slider
#endif
#ifndef PINS
#define PINS 3, 5, 6, 9  // channel 0, 1, ...: `pins` in the experiment file names the same
#endif

// Switches between these pins and ground, for a mechanism that has to say where it is: "labslider" has two, 7 and 8.
// #define SWITCH_PINS 7, 8

enum Safe : uint8_t { HOLD, NEUTRAL, DETACH };
#ifndef SAFE_STATE
#define SAFE_STATE HOLD  // what STOP and the watchdog do to every channel
#endif

#ifndef CURRENT_PIN
#define CURRENT_PIN -1  // analogue pin of a current sensor in the servos' supply; -1 without one
#endif
#ifndef CURRENT_MOST
#define CURRENT_MOST 900  // reading above which the outputs are turned off, if it lasts for CURRENT_MS
#endif
#ifndef CURRENT_MS
#define CURRENT_MS 100
#endif

// --------------------------------------------------------------------------------------------------------------------

static const char FIRMWARE[] = "1.0";
static const char MAX_RATE[] = "0500";
static const uint8_t PIN_OF[] = {PINS};
static const uint8_t CHANNELS = sizeof(PIN_OF);
#ifdef SWITCH_PINS
static const uint8_t SWITCH_OF[] = {SWITCH_PINS};
#endif

static const int16_t PULSE_LEAST_US = 500;
static const int16_t PULSE_MOST_US = 2500;
static const int16_t NEUTRAL_US = 1500;
static const int16_t LEAVE = -1;
static const uint8_t TICK_MS = 20;         // one frame of the servo library
static const uint8_t SLEW_US_PER_MS = 10;  // 1000 deg/s at 10 us/deg: above what servos do, below a jump

static const uint16_t WATCHDOG_LEAST_MS = 20;
static const uint16_t WATCHDOG_MOST_MS = 5000;

static const uint8_t LINE_MOST = 96;
static const uint8_t FIELDS_MOST = CHANNELS + 4;
static const uint8_t REMEMBERED = 4;

struct Channel {
  Servo servo;
  int16_t pulse_us, target_us;
  int16_t least_us, most_us;
  bool attached;
};

struct Answer {
  uint16_t seq, crc;  // of the request; seq 0 is none
  uint8_t length;
  char body[LINE_MOST];
};

static Channel channels[CHANNELS];
static Answer answers[REMEMBERED];
static uint8_t answers_next;

static char line[LINE_MOST];
static uint8_t line_length;
static bool line_overflow;

static char out[3 * LINE_MOST];
static uint16_t out_length;

static char body[LINE_MOST];
static uint8_t body_length;

static uint16_t watchdog_ms;
static bool watchdog_expired;
static bool hardware_fault;
static uint32_t last_good_ms;
static uint32_t updated_ms;

// ---- lines ---------------------------------------------------------------------------------------------------------

static uint16_t checksum(const char *data, uint8_t length) {
  uint16_t crc = 0xFFFF;
  for (uint8_t i = 0; i < length; i++) {
    crc ^= (uint16_t)(uint8_t)data[i] << 8;
    for (uint8_t bit = 0; bit < 8; bit++) crc = (crc & 0x8000) ? (uint16_t)(crc << 1) ^ 0x1021 : (uint16_t)(crc << 1);
  }
  return crc;
}

static char hex_digit(uint8_t nibble) { return "0123456789ABCDEF"[nibble]; }

static void begin_body() { body_length = 0; }

static void add(const char *text) {
  while (*text && body_length < LINE_MOST) body[body_length++] = *text++;
}

static void add_number(uint32_t number) {
  char digits[11];
  uint8_t at = sizeof(digits) - 1;
  digits[at] = 0;
  do {
    digits[--at] = '0' + number % 10;
    number /= 10;
  } while (number);
  add(digits + at);
}

static void add_field(const char *text) {
  add(",");
  add(text);
}

static void add_field(uint32_t number) {
  add(",");
  add_number(number);
}

// Queues a line; one that finds no room is lost, as on a noisy wire: waiting would keep the watchdogs waiting too.
static void send(const char *data, uint8_t length) {
  if (length + 7 > LINE_MOST || (uint16_t)(out_length + length + 7) > sizeof(out)) return;
  uint16_t crc = checksum(data, length);
  out[out_length++] = '$';
  memcpy(out + out_length, data, length);
  out_length += length;
  out[out_length++] = '*';
  for (int8_t shift = 12; shift >= 0; shift -= 4) out[out_length++] = hex_digit((crc >> shift) & 0xF);
  out[out_length++] = '\n';
}

static void send_event(const char *what, const char *detail) {
  begin_body();
  add("0,EV");
  add_field(what);
  if (detail) add_field(detail);
  send(body, body_length);
}

static void flush_out() {
  int room = Serial.availableForWrite();
  if (room <= 0 || out_length == 0) return;
  uint16_t count = (uint16_t)room < out_length ? (uint16_t)room : out_length;
  Serial.write((const uint8_t *)out, count);
  out_length -= count;
  memmove(out, out + count, out_length);
}

// ---- servos --------------------------------------------------------------------------------------------------------

static bool moving() {
  for (uint8_t i = 0; i < CHANNELS; i++)
    if (channels[i].attached && channels[i].pulse_us != channels[i].target_us) return true;
  return false;
}

static void detach(Channel &channel) {
  if (channel.attached) channel.servo.detach();
  channel.attached = false;
}

static void take_safe_state() {
  for (uint8_t i = 0; i < CHANNELS; i++) {
    Channel &channel = channels[i];
    if (SAFE_STATE == DETACH) detach(channel);
    if (SAFE_STATE == NEUTRAL && channel.attached)
      channel.target_us = constrain(NEUTRAL_US, channel.least_us, channel.most_us);
    else
      channel.target_us = channel.pulse_us;
  }
}

// Brings every pulse nearer to its target, by what the slew limit allows since the last time.
static void update(uint32_t now_ms) {
  uint32_t passed_ms = now_ms - updated_ms;
  int16_t most_us = SLEW_US_PER_MS * (passed_ms < TICK_MS ? (int16_t)passed_ms : (int16_t)TICK_MS);
  updated_ms = now_ms;
  for (uint8_t i = 0; i < CHANNELS; i++) {
    Channel &channel = channels[i];
    if (!channel.attached || channel.pulse_us == channel.target_us) continue;
    channel.pulse_us += constrain(channel.target_us - channel.pulse_us, -most_us, most_us);
    channel.servo.writeMicroseconds(channel.pulse_us);
  }
}

static void fail_hardware() {
  hardware_fault = true;
  for (uint8_t i = 0; i < CHANNELS; i++) detach(channels[i]);
  send_event("HW", "OVERCURRENT");
}

static void check_current(uint32_t now_ms) {
#if CURRENT_PIN >= 0
  static uint32_t well_ms;
  if (analogRead(CURRENT_PIN) <= CURRENT_MOST || hardware_fault) well_ms = now_ms;
  if (now_ms - well_ms > CURRENT_MS) fail_hardware();
#else
  (void)now_ms;
  (void)fail_hardware;
#endif
}

// ---- words ---------------------------------------------------------------------------------------------------------

// Reads a whole number; false if it is none.
static bool number_of(const char *text, int32_t &number) {
  bool negative = *text == '-';
  if (negative) text++;
  uint8_t digits = 0;
  number = 0;
  for (; *text; text++, digits++) {
    if (*text < '0' || *text > '9' || digits >= 9) return false;
    number = 10 * number + (*text - '0');
  }
  if (negative) number = -number;
  return digits > 0;
}

static void refuse(const char *code) {
  add("ERR");
  add_field(code);
}

static void refuse_range(uint8_t which) {
  refuse("RANGE");
  add_field((uint32_t)which);
}

static void accept(const char *word) {
  add("OK");
  add_field(word);
}

static void do_hello() {
  accept("HELLO");
  add_field(KIND);
  add_field(FIRMWARE);
  add_field((uint32_t)CHANNELS);
  add_field(MAX_RATE);
}

static void do_watchdog(const char *text, uint32_t now_ms) {
  int32_t ms;
  bool good = number_of(text, ms);
  if (good && ms == 0 && moving()) return refuse("STATE");
  if (!good || (ms != 0 && (ms < WATCHDOG_LEAST_MS || ms > WATCHDOG_MOST_MS))) return refuse_range(0);
  watchdog_ms = ms;
  watchdog_expired = false;
  last_good_ms = now_ms;
  accept("WD");
  add_field((uint32_t)ms);
}

static void do_attach(char **args) {
  int32_t number, least_us, most_us;
  if (!number_of(args[0], number) || number < 0 || number >= CHANNELS) return refuse_range(0);
  if (!number_of(args[1], least_us) || !number_of(args[2], most_us) || least_us < PULSE_LEAST_US ||
      most_us > PULSE_MOST_US || least_us >= most_us)
    return refuse_range(1);
  Channel &channel = channels[number];
  channel.least_us = least_us;
  channel.most_us = most_us;
  channel.target_us = constrain(channel.target_us, channel.least_us, channel.most_us);
  if (!channel.attached) {
    channel.pulse_us = channel.target_us;
    channel.servo.writeMicroseconds(channel.pulse_us);  // before attach: the first pulse is already this one
    channel.servo.attach(PIN_OF[number], PULSE_LEAST_US, PULSE_MOST_US);
    channel.servo.writeMicroseconds(channel.pulse_us);
    channel.attached = true;
  }
  accept("ATT");
}

static void do_set(char **args, uint32_t now_ms) {
  int32_t wanted[CHANNELS];
  for (uint8_t i = 0; i < CHANNELS; i++) {
    int32_t least_us = channels[i].attached ? channels[i].least_us : PULSE_LEAST_US;
    int32_t most_us = channels[i].attached ? channels[i].most_us : PULSE_MOST_US;
    if (!number_of(args[i], wanted[i])) return refuse_range(i);
    if (wanted[i] != LEAVE && (wanted[i] < least_us || wanted[i] > most_us)) return refuse_range(i);
  }
  if (!moving()) updated_ms = now_ms - TICK_MS;  // at rest the first set-point starts the tick
  for (uint8_t i = 0; i < CHANNELS; i++) {
    if (wanted[i] == LEAVE) continue;
    channels[i].target_us = wanted[i];
    if (!channels[i].attached) channels[i].pulse_us = wanted[i];
  }
  update(now_ms);
  accept("SV");
}

static void do_detach(const char *text) {
  int32_t number;
  if (!number_of(text, number) || number < 0 || number >= CHANNELS) return refuse_range(0);
  detach(channels[number]);
  accept("DET");
}

static void do_status(uint32_t now_ms) {
  accept("ST");
  add_field((uint32_t)(hardware_fault ? 3 : watchdog_expired ? 2 : moving() ? 1 : 0));
  for (uint8_t i = 0; i < CHANNELS; i++) add_field((uint32_t)channels[i].pulse_us);
  add_field(now_ms);
}

static void do_switches() {
  accept("SW");
#ifdef SWITCH_PINS
  for (uint8_t i = 0; i < sizeof(SWITCH_OF); i++) add_field((uint32_t)(digitalRead(SWITCH_OF[i]) == LOW));
#endif
}

// Whether a word that moves something may be carried out; says why not.
static bool may_move() {
  if (hardware_fault) {
    refuse("HW");
    add_field("OVERCURRENT");
    return false;
  }
  if (watchdog_ms == 0) {
    refuse("WDOG");
    return false;
  }
  return true;
}

static void carry_out(const char *word, char **args, uint8_t count, uint32_t now_ms) {
  struct Word {
    const char *word;
    uint8_t arguments;
    bool moves;
  };
  static const Word WORDS[] = {{"HELLO", 0, false}, {"WD", 1, false}, {"ATT", 3, true}, {"SV", CHANNELS, true},
                               {"DET", 1, false},   {"STOP", 0, false}, {"ST", 0, false}, {"SW", 0, false},
                               {"PING", 0, false}};
  uint8_t which = 0;
  while (which < 9 && strcmp(word, WORDS[which].word) != 0) which++;
  if (which == 9) return refuse("WORD");
  if (count != WORDS[which].arguments) return refuse("ARGC");
  if (WORDS[which].moves && !may_move()) return;
  switch (which) {
    case 0: return do_hello();
    case 1: return do_watchdog(args[0], now_ms);
    case 2: return do_attach(args);
    case 3: return do_set(args, now_ms);
    case 4: return do_detach(args[0]);
    case 5: take_safe_state(); return accept("STOP");
    case 6: return do_status(now_ms);
    case 7: return do_switches();
    default: return accept("PING");
  }
}

// ---- requests ------------------------------------------------------------------------------------------------------

static int8_t value_of(char digit) {
  if (digit >= '0' && digit <= '9') return digit - '0';
  if (digit >= 'A' && digit <= 'F') return digit - 'A' + 10;
  return -1;
}

// Carries out the line received, without its newline; drops it if it is not whole.
static void take_line(uint32_t now_ms) {
  uint8_t begin = line_length;  // the last $: what stands before it is the rest of a line that lost its end
  while (begin > 0 && line[begin - 1] != '$') begin--;
  char *text = line + begin;
  uint8_t length = line_length - begin;
  if (begin == 0 || length < 5 || text[length - 5] != '*') return;
  uint16_t told = 0;
  for (uint8_t i = length - 4; i < length; i++) {
    int8_t value = value_of(text[i]);
    if (value < 0) return;
    told = (told << 4) | (uint16_t)value;
  }
  length -= 5;
  if (checksum(text, length) != told) return;
  for (uint8_t i = 0; i < length; i++)
    if (text[i] < 0x20 || text[i] > 0x7E) return;

  text[length] = 0;
  char *fields[FIELDS_MOST];
  uint8_t count = 0;
  for (char *at = text; count < FIELDS_MOST; at++) {
    fields[count++] = at;
    at = strchr(at, ',');
    if (!at) break;
    *at = 0;
  }
  int32_t seq;
  if (count < 2 || strlen(fields[0]) > 5 || fields[0][0] == '-' || !number_of(fields[0], seq)) return;
  if (seq < 1 || seq > 65535) return;
  last_good_ms = now_ms;

  // STOP and WD act every time: both can be done twice, and neither may be answered from memory.
  bool always = strcmp(fields[1], "STOP") == 0 || strcmp(fields[1], "WD") == 0;
  for (uint8_t i = 0; i < REMEMBERED && !always; i++)
    if (answers[i].seq == (uint16_t)seq && answers[i].crc == told) return send(answers[i].body, answers[i].length);

  begin_body();
  add_number((uint32_t)seq);
  add(",");
  carry_out(fields[1], fields + 2, count - 2, now_ms);
  send(body, body_length);
  Answer &kept = answers[answers_next];
  answers_next = (answers_next + 1) % REMEMBERED;
  kept.seq = seq;
  kept.crc = told;
  kept.length = body_length;
  memcpy(kept.body, body, body_length);
}

static void receive(uint32_t now_ms) {
  while (Serial.available() > 0) {
    char byte = Serial.read();
    if (byte == '\n') {
      if (!line_overflow) take_line(now_ms);
      line_length = 0;
      line_overflow = false;
    } else if (line_length < LINE_MOST - 1) {
      line[line_length++] = byte;
    } else {
      line_overflow = true;
      if (byte == '$') {  // the beginning of another line: what stood before has lost its end
        line[0] = byte;
        line_length = 1;
        line_overflow = false;
      }
    }
  }
}

static void check_watchdog(uint32_t now_ms) {
  if (watchdog_ms == 0 || now_ms - last_good_ms <= watchdog_ms) return;
  watchdog_ms = 0;
  watchdog_expired = true;
  take_safe_state();
  send_event("WDOG", 0);
}

// --------------------------------------------------------------------------------------------------------------------

void setup() {
  MCUSR = 0;  // or a reset by the chip's watchdog would leave it at its shortest time
  wdt_disable();
  for (uint8_t i = 0; i < CHANNELS; i++) channels[i].pulse_us = channels[i].target_us = NEUTRAL_US;
#ifdef SWITCH_PINS
  for (uint8_t i = 0; i < sizeof(SWITCH_OF); i++) pinMode(SWITCH_OF[i], INPUT_PULLUP);
#endif
  wdt_enable(WDTO_250MS);
  Serial.begin(115200);
  send_event("BOOT", FIRMWARE);
}

void loop() {
  wdt_reset();
  uint32_t now_ms = millis();
  receive(now_ms);
  check_watchdog(now_ms);
  if (moving() && now_ms - updated_ms >= TICK_MS) update(now_ms);
  check_current(now_ms);
  flush_out();
}
