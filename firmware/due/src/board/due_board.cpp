#include "due_board.h"

#include <Arduino.h>

#include "../motor_levels.h"

namespace hostlink {

namespace {

struct MotorPins {
  uint8_t direction;
  uint8_t brake;
  uint8_t pwm;
  uint8_t encoder;
  bool is_reversed;
};

// Rewired from the shield's own pins (docs/build-robot.md#wiring-of-the-due). Constants have a k: the Due's headers
// define PWM, UART, ADC and the like.
const MotorPins kLeft = {2, 9, 3, 22, kIsReversedLeft};
const MotorPins kRight = {5, 8, 6, 23, kIsReversedRight};
const uint32_t kBaud = 38400;
const uint8_t kPwmBits = 12;
const uint8_t kBatteryPin = A2;  // A0 and A1 have the shield's current senses
#if defined(ARDUINO_ARCH_SAM)
const uint32_t kFullCounts = 4095;
const float kReferenceV = 3.3f;
const uint32_t kResetByWatchdog = 2;  // SAM3X, RSTTYP
#else
const uint32_t kFullCounts = 1023;
const float kReferenceV = 5.0f;
#endif
const uint32_t kLeastPulseUs = 500;  // at 280 ticks/s an edge arrives every 1.8 ms; faster edges are a bouncing sensor
const uint32_t kQuietMs = 2000;      // after power-up: the ESP8266 prints its boot message at another baud rate
const uint32_t kWatchdogMs = 500;    // the board restarts with its motors off when the loop has not run for this time

struct Encoder {  // written by the interrupt
  volatile uint32_t edges;
  volatile uint32_t edge_us;
  volatile int level;  // after the last edge: a bounce that ends at its starting level is not an edge
};

Encoder left_encoder = {0, 0, LOW};
Encoder right_encoder = {0, 0, LOW};

void count(Encoder& encoder, uint8_t pin) {
  const uint32_t now_us = ::micros();
  const int level = digitalRead(pin);
  if (level == encoder.level || now_us - encoder.edge_us < kLeastPulseUs) return;
  encoder.edge_us = now_us;
  encoder.level = level;
  encoder.edges = encoder.edges + 1;
}

void count_left() { count(left_encoder, kLeft.encoder); }
void count_right() { count(right_encoder, kRight.encoder); }

void write_duty(const MotorPins& pins, int16_t duty) {
#if defined(ARDUINO_ARCH_SAM)
  analogWrite(pins.pwm, duty);
#else
  analogWrite(pins.pwm, duty >> (kPwmBits - 8));  // a board without analogWriteResolution has 8 bits
#endif
}

// Write the pins in an order that never drives harder than before or after: the full duty of a brake is written after
// BRAKE is set, and is removed before BRAKE is cleared.
void drive_motor(const MotorPins& pins, int16_t pwm) {
  const MotorLevels levels = motor_levels(pwm, pins.is_reversed);
  if (levels.brake) {
    digitalWrite(pins.brake, HIGH);
    write_duty(pins, levels.duty);
  } else {
    write_duty(pins, levels.duty);
    digitalWrite(pins.direction, levels.direction ? HIGH : LOW);
    digitalWrite(pins.brake, LOW);
  }
}

void begin_motor(const MotorPins& pins, Encoder& encoder) {
  pinMode(pins.direction, OUTPUT);
  pinMode(pins.brake, OUTPUT);
  pinMode(pins.pwm, OUTPUT);
  drive_motor(pins, 0);
  pinMode(pins.encoder, INPUT_PULLUP);
  encoder.level = digitalRead(pins.encoder);
}

}  // namespace

void DueBoard::begin() {
#if defined(ARDUINO_ARCH_SAM)
  analogWriteResolution(kPwmBits);
  analogReadResolution(12);
#endif
  begin_motor(kLeft, left_encoder);
  begin_motor(kRight, right_encoder);
  attachInterrupt(digitalPinToInterrupt(kLeft.encoder), count_left, CHANGE);
  attachInterrupt(digitalPinToInterrupt(kRight.encoder), count_right, CHANGE);
  Serial1.begin(kBaud);
  started_at_ms_ = ::millis();
}

void DueBoard::run() {
#if defined(ARDUINO_ARCH_SAM)
  if (!is_watched_) watchdogEnable(kWatchdogMs);
  is_watched_ = true;
  watchdogReset();
#endif
  if (!is_quiet_ && ::millis() - started_at_ms_ < kQuietMs) {
    while (Serial1.available() > 0) Serial1.read();  // boot noise
  } else {
    is_quiet_ = true;
  }
}

uint32_t DueBoard::milliseconds() { return ::millis(); }

uint32_t DueBoard::micros() { return ::micros(); }

int DueBoard::read() { return Serial1.read(); }

size_t DueBoard::write(const uint8_t* data, size_t size) {
  const int room = Serial1.availableForWrite();  // a full ring would make write() wait
  if (room <= 0) return 0;
  const size_t taken = size < static_cast<size_t>(room) ? size : static_cast<size_t>(room);
  return Serial1.write(data, taken);
}

void DueBoard::drive(int16_t left_pwm, int16_t right_pwm) {
  drive_motor(kLeft, left_pwm);
  drive_motor(kRight, right_pwm);
}

void DueBoard::edges(uint32_t& left, uint32_t& right) {
  noInterrupts();  // both values from one moment
  left = left_encoder.edges;
  right = right_encoder.edges;
  interrupts();
}

float DueBoard::battery_v() {
  const uint32_t counts = kBatteryDivider > 0.0f ? static_cast<uint32_t>(analogRead(kBatteryPin)) : 0;
  return battery_volts(counts, kFullCounts, kReferenceV, kBatteryDivider);
}

bool DueBoard::was_hung() {
#if defined(ARDUINO_ARCH_SAM)
  return (RSTC->RSTC_SR & RSTC_SR_RSTTYP_Msk) >> RSTC_SR_RSTTYP_Pos == kResetByWatchdog;
#else
  return false;
#endif
}

}  // namespace hostlink

#if defined(ARDUINO_ARCH_SAM)
// The core turns the watchdog off at the start unless the sketch defines this function, and its register can be
// written once. So the watchdog keeps its reset value, 16 s, until loop() runs: setup() may take its time.
void watchdogSetup() {}
#endif
