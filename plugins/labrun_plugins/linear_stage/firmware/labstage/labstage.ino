// labstage 1.0: a stepper stage with a load cell (HX711), speaking labline v1 at 115200 baud.
//
// For an ATmega328P at 16 MHz (Uno, Nano). A line is $<seq>,<word>[,<arg>...]*<CRC-16/CCITT-FALSE>\n; see the README.
// Position and force are latched together at the amplifier's ready edge. End switches and the force limit act inside
// the step interrupt; STOP slows down, everything else stops at once. Nothing here waits.

#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#if defined(__AVR__)
#include <avr/interrupt.h>
#include <avr/wdt.h>
#endif

// ---- what is wired, and what the stage is: adapt these -----------------------------------------------------------
const uint8_t PIN_DOUT = 2;        // HX711 data; must be an external interrupt (2 or 3)
const uint8_t PIN_SCK = 4;         // HX711 clock
const uint8_t PIN_STEP = 5;
const uint8_t PIN_DIR = 6;
const uint8_t PIN_ENABLE = 7;      // low = motor on; a pull-up keeps it off during a reset
const uint8_t PIN_LOW_SWITCH = 8;  // normally closed to ground: a broken wire reads as pressed
const uint8_t PIN_HIGH_SWITCH = 9;
const bool UP_IS_HIGH = true;          // level of PIN_DIR that moves away from the lower switch
const int32_t STEPS_PER_MM = 1600;     // 200 steps a turn, 16 microsteps, 2 mm lead
const int32_t FASTEST_THOU_S = 10000;  // thousandths of a millimetre a second
const int32_t HOMING_THOU_S = 5000;
const int32_t BACK_OFF_STEPS = STEPS_PER_MM / 2;
const int32_t ACCELERATION = 200 * STEPS_PER_MM;  // steps/s^2
const uint16_t SAMPLES_HZ = 80;                   // as the RATE pin of the HX711 says: 10 or 80

// ---- numbers that follow ------------------------------------------------------------------------------------------
const char FIRMWARE[] = "1.0";
const uint16_t TICK_HZ = 25000;
const uint8_t TICKS_PER_RAMP = 25;  // speed changes once a millisecond
const int32_t ONE_STEP = 256L * TICK_HZ;
const int32_t RAMP = ACCELERATION / 1000 * 256L;      // speed is kept in 1/256 steps/s
const int32_t CREEP = STEPS_PER_MM / 10 * 256L;       // the last steps of a ramp, 0.1 mm/s
const int32_t MOST_COUNTS = 0x7FFFFFL;
const int32_t LEAST_COUNTS = -0x800000L;
const uint8_t LINE_BYTES = 96;
const uint8_t ANSWER_BYTES = 72;
const uint8_t REMEMBERED = 4;
const uint16_t OUT_BYTES = 256;

struct Text;  // ahead of the first function: the Arduino builder puts prototypes there
enum Mode : uint8_t { STILL, TO, RUN, BRAKE, SEEK, BACK };
enum Which : uint8_t { NONE, LOW_END, HIGH_END, FORCE, CELL };
const char *const WHICH_NAMES[] = {"", "LOW", "HIGH", "FORCE", "CELL"};

// ---- shared with the interrupts -----------------------------------------------------------------------------------
volatile Mode mode = STILL;
volatile int32_t position = 0;     // steps; from the lower switch once homed
volatile int32_t target = 0;       // steps
volatile int32_t wanted = 0;       // 1/256 steps/s, signed; its magnitude for TO
volatile int32_t speed = 0;        // 1/256 steps/s, signed
volatile int32_t counts = 0;       // latest of the amplifier
volatile int32_t mostCounts = MOST_COUNTS;
volatile int32_t deeperCounts = 0;  // bound while it backs out of a force beyond its limit
volatile int32_t softLow = INT32_MIN, softHigh = INT32_MAX;
volatile bool homed = false;
volatile bool forceLimit = false;
volatile int8_t trippedSign = 0;
volatile Which stoppedBy = NONE;   // reported by the loop, after the stop
volatile bool edge = false;        // the amplifier is ready: the two below were latched with it
volatile uint32_t edgeMicros = 0;
volatile int32_t edgePosition = 0;
volatile int32_t edgePhase = 0;    // of the way to the next step, signed, out of ONE_STEP
volatile bool reading = false;     // its data line toggles while it is read

volatile int32_t phase = 0;  // of the way to the next step, out of ONE_STEP
uint8_t rampTick = 0;

int32_t magnitude(int32_t value) { return value < 0 ? -value : value; }
int8_t signOf(int32_t value) { return value > 0 ? 1 : value < 0 ? -1 : 0; }

#if defined(__AVR_ATmega328P__)
bool lowPressed() { return PINB & _BV(0); }   // pin 8
bool highPressed() { return PINB & _BV(1); }  // pin 9
void stepPin(bool level) { if (level) PORTD |= _BV(5); else PORTD &= ~_BV(5); }
#else
bool lowPressed() { return digitalRead(PIN_LOW_SWITCH) == HIGH; }
bool highPressed() { return digitalRead(PIN_HIGH_SWITCH) == HIGH; }
void stepPin(bool level) { digitalWrite(PIN_STEP, level ? HIGH : LOW); }
#endif

bool atLow() { return lowPressed() || (homed && position < softLow); }
bool atHigh() { return highPressed() || (homed && position > softHigh); }

// With microsteps the screw turns evenly from step to step: the phase of the step clock tells where it is between two.
int32_t signedPhase() { return speed < 0 ? -phase : phase; }

// ---- step interrupt -----------------------------------------------------------------------------------------------
void halt() {
  mode = STILL;
  speed = wanted = phase = 0;
}

// Stop at once at a switch, a limit of travel or a force, in the sense that leads further.
bool minded() {
  const int8_t sign = signOf(speed);
  Which which = NONE;
  const int32_t bound = forceLimit && deeperCounts > mostCounts ? deeperCounts : mostCounts;
  if (magnitude(counts) > bound) which = FORCE;
  else if (sign < 0 && mode != SEEK && atLow()) which = LOW_END;
  else if (sign > 0 && mode != BACK && atHigh()) which = HIGH_END;
  if (which == NONE) return false;
  if (which == FORCE) {
    forceLimit = true;
    deeperCounts = magnitude(counts) + magnitude(counts) / 20;
    trippedSign = sign;
  }
  halt();
  stoppedBy = which;
  return true;
}

void ramp() {
  int32_t goal = wanted;
  if (mode == TO) {
    const int32_t left = target - position;
    const int32_t most = magnitude(wanted);
    goal = left > 0 ? most : -most;
    const int32_t now = magnitude(speed) >> 8;  // steps/s
    const int32_t way = magnitude(left);
    // v^2 >= 2 a s: time to slow down. The products stay inside 32 bits: beyond 1000 steps it is never time.
    if (way < 1000 && now * now >= 2 * ACCELERATION / 1000 * way * 1000) {
      goal = left > 0 ? CREEP : -CREEP;
      if (magnitude(goal) > most) goal = left > 0 ? most : -most;
    }
  }
  const int32_t change = goal - speed;
  if (change > RAMP) speed += RAMP;
  else if (change < -RAMP) speed -= RAMP;
  else speed = goal;
  if (mode == BRAKE && speed == 0) halt();
}

void tick() {
  if (mode == STILL) return;
  if (++rampTick >= TICKS_PER_RAMP) {
    rampTick = 0;
    ramp();
    if (mode == STILL) return;
  }
  if (mode == SEEK && lowPressed()) {
    speed = 0;
    mode = BACK;
    wanted = HOMING_THOU_S / 5 * STEPS_PER_MM / 1000 * 256L;
    position = 0;
    return;
  }
  if (minded()) return;
  if (mode == TO && position == target) {
    halt();
    return;
  }
  phase += magnitude(speed);
  if (phase < ONE_STEP) return;
  phase -= ONE_STEP;
  const bool up = speed > 0;
  digitalWrite(PIN_DIR, up == UP_IS_HIGH ? HIGH : LOW);
  stepPin(true);
  position += up ? 1 : -1;
  if (mode == BACK && position >= BACK_OFF_STEPS) {
    homed = true;
    halt();
  }
  stepPin(false);  // the lines between have made the pulse longer than the 1 us that a driver asks for
}

#if defined(__AVR__)
ISR(TIMER1_COMPA_vect) { tick(); }
#endif

void ready() {
  if (reading || edge) return;
  edgeMicros = micros();
  edgePosition = position;
  edgePhase = signedPhase();
  edge = true;
}

// ---- lines out ----------------------------------------------------------------------------------------------------
char outBuffer[OUT_BYTES];
uint16_t outFirst = 0, outCount = 0;

uint16_t crcOf(const char *data, uint8_t length) {
  uint16_t crc = 0xFFFF;
  for (uint8_t i = 0; i < length; i++) {
    crc ^= (uint16_t)(uint8_t)data[i] << 8;
    for (uint8_t bit = 0; bit < 8; bit++) crc = crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1;
  }
  return crc;
}

// A line under construction, without $ and checksum.
struct Text {
  char data[ANSWER_BYTES];
  uint8_t length = 0;
  void add(char one) { if (length < ANSWER_BYTES) data[length++] = one; }
  void add(const char *text) { while (*text) add(*text++); }
  void add(uint32_t value) {
    char digits[11];
    uint8_t count = 0;
    do { digits[count++] = '0' + value % 10; value /= 10; } while (value);
    while (count) add(digits[--count]);
  }
  void addSigned(int32_t value) {
    if (value < 0) add('-');
    add((uint32_t)magnitude(value));
  }
  void addPosition(int32_t steps, int32_t parts) {  // mm with five decimals; parts of a step are out of ONE_STEP
    const int32_t small = (int32_t)(((int64_t)steps * ONE_STEP + parts) * 100000 / STEPS_PER_MM / ONE_STEP);
    if (small < 0) add('-');
    uint32_t rest = magnitude(small);
    add(rest / 100000);
    add('.');
    rest %= 100000;
    for (uint32_t place = 10000; place; place /= 10) add((char)('0' + rest / place % 10));
  }
};

bool send(const Text &text) {
  const uint16_t crc = crcOf(text.data, text.length);
  if (outCount + text.length + 7 > OUT_BYTES) return false;
  char tail[6] = {'*', 0, 0, 0, 0, '\n'};
  for (uint8_t i = 0; i < 4; i++) tail[1 + i] = "0123456789ABCDEF"[crc >> (12 - 4 * i) & 15];
  outBuffer[(outFirst + outCount++) % OUT_BYTES] = '$';
  for (uint8_t i = 0; i < text.length; i++) outBuffer[(outFirst + outCount++) % OUT_BYTES] = text.data[i];
  for (uint8_t i = 0; i < 6; i++) outBuffer[(outFirst + outCount++) % OUT_BYTES] = tail[i];
  return true;
}

void drain() {
  while (outCount && Serial.availableForWrite() > 0) {
    Serial.write(outBuffer[outFirst]);
    outFirst = (outFirst + 1) % OUT_BYTES;
    outCount--;
  }
}

void event(const char *what, const char *detail) {
  Text text;
  text.add("0,EV,");
  text.add(what);
  if (detail[0]) { text.add(','); text.add(detail); }
  send(text);
}

// ---- state --------------------------------------------------------------------------------------------------------
uint16_t watchdogMs = 0;
uint32_t lastGood = 0;
bool tripped = false;       // the watchdog has expired
uint16_t everySample = 0;   // so many conversions make a sample; 0 = none
uint16_t conversion = 0;
uint32_t sampleNumber = 0;
uint32_t lastReady = 0;
bool notReady = true;

uint8_t flags() {
  noInterrupts();  // the interrupt moves the position, four bytes of it, while they are compared
  const uint8_t found = (mode != STILL) | homed << 1 | atLow() << 2 | atHigh() << 3 | forceLimit << 4;
  interrupts();
  return found | (counts >= MOST_COUNTS || counts <= LEAST_COUNTS) << 5 | notReady << 6 | tripped << 7;
}

void sample(uint32_t atMicros, int32_t atPosition, int32_t atPhase) {
  sampleNumber++;  // also of one that finds no room: the host sees the gap
  Text text;
  text.add("0,S,");
  text.add(sampleNumber);
  text.add(',');
  text.add(atMicros);
  text.add(',');
  text.addPosition(atPosition, atPhase);
  text.add(',');
  text.addSigned(counts);
  text.add(',');
  text.add((uint32_t)flags());
  if (OUT_BYTES > outCount + text.length + 7 + ANSWER_BYTES) send(text);  // answers have room before samples
}

int32_t readCounts() {
  uint32_t raw = 0;
  reading = true;
  for (uint8_t i = 0; i < 25; i++) {  // the 25th pulse: channel A, gain 128, for the next conversion
    noInterrupts();                   // more than 60 us of high would put the chip to sleep
    digitalWrite(PIN_SCK, HIGH);
    if (i < 24) raw = raw << 1 | (digitalRead(PIN_DOUT) == HIGH);
    digitalWrite(PIN_SCK, LOW);
    interrupts();
  }
  reading = false;
  return raw & 0x800000UL ? (int32_t)(raw | 0xFF000000UL) : (int32_t)raw;
}

void convert() {
  if (!edge && digitalRead(PIN_DOUT) == LOW) {  // an edge that came while it was read
    noInterrupts();
    edgeMicros = micros();
    edgePosition = position;
    edgePhase = signedPhase();
    edge = true;
    interrupts();
  }
  if (edge && digitalRead(PIN_DOUT) == HIGH) edge = false;  // a bit that fell while it was read
  if (edge) {
    const int32_t latest = readCounts();
    noInterrupts();
    counts = latest;
    if (forceLimit && magnitude(latest) <= mostCounts) forceLimit = false;
    const uint32_t atMicros = edgeMicros;
    const int32_t atPosition = edgePosition, atPhase = edgePhase;
    edge = false;
    interrupts();
    lastReady = millis();
    notReady = false;
    if (everySample && ++conversion >= everySample) {
      conversion = 0;
      sample(atMicros, atPosition, atPhase);
    }
  } else if (millis() - lastReady > 3000UL / SAMPLES_HZ) {
    lastReady = millis();
    notReady = true;
    noInterrupts();
    if (mode != STILL && mostCounts < MOST_COUNTS) {  // nobody feels the force that is to be limited
      halt();
      stoppedBy = CELL;
    }
    interrupts();
    if (everySample) sample(micros(), position, 0);
  }
}

void makeSafe(bool gently) {
  noInterrupts();
  if (!gently) halt();
  else if (mode != STILL) { mode = BRAKE; wanted = 0; }
  interrupts();
}

// ---- words --------------------------------------------------------------------------------------------------------
// Each returns nullptr and adds what stands behind OK,<word> to the answer, or returns what stands behind ERR.
const uint8_t MOST_ARGUMENTS = 4;
char *arguments[MOST_ARGUMENTS];
uint8_t argumentCount = 0;

// Thousandths of a decimal number with three places at most.
bool thousandths(const char *text, int32_t &value) {
  bool negative = *text == '-';
  if (*text == '-' || *text == '+') text++;
  int32_t whole = 0;
  int8_t places = -1;
  uint8_t digits = 0;
  for (; *text; text++) {
    if (*text == '.' && places < 0) { places = 0; continue; }
    if (*text < '0' || *text > '9' || ++digits > 8 || places >= 3) return false;
    whole = whole * 10 + (*text - '0');
    if (places >= 0) places++;
  }
  if (!digits) return false;
  for (int8_t i = places < 0 ? 0 : places; i < 3; i++) {
    if (whole > 99999999L) return false;
    whole *= 10;
  }
  value = negative ? -whole : whole;
  return true;
}

int32_t stepsOf(int32_t thou) { return (int32_t)((int64_t)thou * STEPS_PER_MM / 1000); }
int32_t speedOf(int32_t thou) { return (int32_t)((int64_t)thou * STEPS_PER_MM * 256 / 1000); }

const char *blocked(int8_t sign) {
  if (!homed) return "STATE,HOME";
  if (sign < 0 && atLow()) return "LIMIT,LOW";
  if (sign > 0 && atHigh()) return "LIMIT,HIGH";
  if (forceLimit && sign == trippedSign) return "LIMIT,FORCE";
  return nullptr;
}

const char *doHome(Text &) {
  noInterrupts();
  homed = false;
  wanted = -speedOf(HOMING_THOU_S);
  mode = SEEK;
  interrupts();
  return nullptr;
}

const char *doMove(Text &) {
  int32_t to, at;
  if (!thousandths(arguments[0], to) || !homed) return homed ? "RANGE,0" : "STATE,HOME";
  const int32_t goal = stepsOf(to);
  if (goal < softLow || goal > softHigh) return "RANGE,0";
  if (!thousandths(arguments[1], at) || at <= 0 || at > FASTEST_THOU_S) return "RANGE,1";
  noInterrupts();
  const char *refusal = blocked(signOf(goal - position));
  if (!refusal) {
    target = goal;
    wanted = speedOf(at);
    mode = TO;
  }
  interrupts();
  return refusal;
}

const char *doVelocity(Text &) {
  int32_t at;
  if (!thousandths(arguments[0], at) || magnitude(at) > FASTEST_THOU_S) return "RANGE,0";
  noInterrupts();
  const char *refusal = blocked(signOf(at));
  if (!refusal) {
    wanted = speedOf(at);
    mode = at ? RUN : BRAKE;
  }
  interrupts();
  return refusal;
}

const char *doStream(Text &) {
  int32_t rate;
  if (!thousandths(arguments[0], rate) || rate < 0 || rate > 1000L * SAMPLES_HZ) return "RANGE,0";
  if (rate && rate < 1000) return "RANGE,0";
  everySample = rate ? (1000L * SAMPLES_HZ + rate / 2) / rate : 0;
  conversion = 0;
  return nullptr;
}

const char *doLimits(Text &) {
  int32_t low, high;
  if (!thousandths(arguments[0], low)) return "RANGE,0";
  if (!thousandths(arguments[1], high) || high <= low) return "RANGE,1";
  char *end;
  const long most = strtol(arguments[2], &end, 10);
  if (*end || most <= 0 || most > MOST_COUNTS) return "RANGE,2";
  noInterrupts();
  softLow = stepsOf(low);
  softHigh = stepsOf(high);
  mostCounts = most;
  interrupts();
  return nullptr;
}

const char *doState(Text &answer) {
  noInterrupts();
  const int32_t here = position;
  interrupts();
  answer.add(',');
  answer.add((uint32_t)flags());
  answer.add(',');
  answer.addPosition(here, 0);
  answer.add(',');
  answer.addSigned(counts);
  answer.add(',');
  answer.add((uint32_t)millis());
  return nullptr;
}

const char *doHello(Text &answer) {
  answer.add(",labstage,");
  answer.add(FIRMWARE);
  answer.add(",1,00");
  answer.add((uint32_t)SAMPLES_HZ);
  return nullptr;
}

const char *doWatchdog(Text &answer) {
  char *end;
  const long ms = strtol(arguments[0], &end, 10);
  if (*end || ms < 0 || ms > 5000 || (ms && ms < 20)) return "RANGE,0";
  if (!ms && mode != STILL) return "STATE,MOVING";
  watchdogMs = ms;
  tripped = false;
  answer.add(',');
  answer.add((uint32_t)ms);
  return nullptr;
}

const char *doStop(Text &) { makeSafe(true); return nullptr; }
const char *doPing(Text &) { return nullptr; }

struct Word {
  const char *name;
  uint8_t argumentsWanted;
  bool moves;
  bool actsAgain;  // can be done twice, so it is never answered from memory
  const char *(*act)(Text &);
};

const Word WORDS[] = {
    {"HELLO", 0, false, false, doHello}, {"WD", 1, false, true, doWatchdog}, {"PING", 0, false, false, doPing},
    {"STOP", 0, false, true, doStop},    {"HOME", 0, true, false, doHome},   {"MV", 2, true, false, doMove},
    {"VEL", 1, true, false, doVelocity}, {"STR", 1, false, false, doStream}, {"LIM", 3, false, false, doLimits},
    {"ST", 0, false, false, doState},
};

// ---- lines in -----------------------------------------------------------------------------------------------------
char line[LINE_BYTES];
uint8_t lineLength = 0;
bool overflow = false;

struct Memory {
  uint16_t seq = 0;
  uint16_t crc = 0;
  Text answer;
};
Memory memories[REMEMBERED];
uint8_t oldest = 0;

int8_t hexOf(char digit) {
  if (digit >= '0' && digit <= '9') return digit - '0';
  return digit >= 'A' && digit <= 'F' ? digit - 'A' + 10 : -1;
}

void carryOut(uint16_t seq, uint16_t crc, char *rest) {
  char *word = rest;
  argumentCount = 0;
  for (char *mark = strchr(rest, ','); mark; mark = strchr(mark + 1, ',')) {
    *mark = 0;
    if (argumentCount < MOST_ARGUMENTS) arguments[argumentCount] = mark + 1;
    argumentCount++;
  }
  const Word *known = nullptr;
  for (const Word &one : WORDS)
    if (!strcmp(one.name, word)) known = &one;
  if (!known || !known->actsAgain) {
    for (const Memory &memory : memories) {
      if (memory.answer.length && memory.seq == seq && memory.crc == crc) {
        send(memory.answer);
        return;
      }
    }
  }
  Text answer;
  answer.add((uint32_t)seq);
  Text told = answer;
  told.add(",OK,");
  told.add(word);
  const char *refusal = !known                                       ? "WORD"
                        : argumentCount != known->argumentsWanted    ? "ARGC"
                        : known->moves && !watchdogMs                ? "WDOG"
                                                                     : known->act(told);
  if (refusal) {
    answer.add(",ERR,");
    answer.add(refusal);
    told = answer;
  }
  send(told);
  memories[oldest].seq = seq;
  memories[oldest].crc = crc;
  memories[oldest].answer = told;
  oldest = (oldest + 1) % REMEMBERED;
}

void takeLine() {
  if (overflow || lineLength < 8) return;
  line[lineLength] = 0;
  char *body = strrchr(line, '$');
  if (!body || strlen(body) != (size_t)(line + lineLength - body)) return;  // a zero byte is no line
  body++;
  const uint8_t length = line + lineLength - body;
  if (length < 8 || body[length - 5] != '*') return;
  uint16_t given = 0;
  for (uint8_t i = 0; i < 4; i++) {
    const int8_t digit = hexOf(body[length - 4 + i]);
    if (digit < 0) return;
    given = given << 4 | digit;
  }
  if (crcOf(body, length - 5) != given) return;
  body[length - 5] = 0;
  char *comma = strchr(body, ',');
  if (!comma || comma == body || comma - body > 5) return;
  uint32_t seq = 0;
  for (char *digit = body; digit < comma; digit++) {
    if (*digit < '0' || *digit > '9') return;
    seq = seq * 10 + (*digit - '0');
  }
  if (seq < 1 || seq > 65535UL) return;
  lastGood = millis();
  carryOut(seq, given, comma + 1);
}

void takeByte(char one) {
  if (one == '\n') {
    takeLine();
    lineLength = 0;
    overflow = false;
  } else if (one == '$' && overflow) {  // the beginning of another line: what stood before has lost its end
    line[0] = one;
    lineLength = 1;
    overflow = false;
  } else if (lineLength < LINE_BYTES - 1) {
    line[lineLength++] = one;
  } else {
    overflow = true;
  }
}

// ---- Arduino ------------------------------------------------------------------------------------------------------
void setup() {
  pinMode(PIN_ENABLE, OUTPUT);
  digitalWrite(PIN_ENABLE, HIGH);  // motor off until everything is known
#if defined(__AVR__)
  wdt_enable(WDTO_250MS);
#endif
  pinMode(PIN_STEP, OUTPUT);
  pinMode(PIN_DIR, OUTPUT);
  pinMode(PIN_SCK, OUTPUT);
  digitalWrite(PIN_SCK, LOW);
  pinMode(PIN_DOUT, INPUT);
  pinMode(PIN_LOW_SWITCH, INPUT_PULLUP);
  pinMode(PIN_HIGH_SWITCH, INPUT_PULLUP);
  attachInterrupt(digitalPinToInterrupt(PIN_DOUT), ready, FALLING);
#if defined(__AVR__)
  noInterrupts();
  TCCR1A = 0;
  TCCR1B = _BV(WGM12) | _BV(CS10);
  OCR1A = F_CPU / TICK_HZ - 1;
  TIMSK1 = _BV(OCIE1A);
  interrupts();
#endif
  Serial.begin(115200);
  digitalWrite(PIN_ENABLE, LOW);
  event("BOOT", FIRMWARE);
}

void loop() {
#if defined(__AVR__)
  wdt_reset();
#endif
  while (Serial.available() > 0) takeByte((char)Serial.read());
  if (watchdogMs && millis() - lastGood > watchdogMs) {
    makeSafe(false);
    watchdogMs = 0;
    tripped = true;
    event("WDOG", "");
  }
  convert();
  if (stoppedBy != NONE) {
    const Which which = stoppedBy;
    stoppedBy = NONE;
    event("LIMIT", WHICH_NAMES[which]);
  }
  drain();
}
