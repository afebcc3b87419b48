#include "pins.h"

#include "Arduino.h"

namespace due_pins {

namespace {

Pins the_pins;

void note(uint32_t pin, uint32_t value) {
  the_pins.value[pin] = static_cast<uint16_t>(value);
  if (the_pins.writes.size() == kLogMax) return;
  the_pins.writes.push_back({static_cast<uint8_t>(pin), static_cast<uint16_t>(value)});
}

}  // namespace

Pins& pins() { return the_pins; }

void power_up() { the_pins = Pins(); }

}  // namespace due_pins

using due_pins::the_pins;

SerialPort Serial1;
Rstc the_reset_controller = {0};

void pinMode(uint32_t, uint32_t) {}
void digitalWrite(uint32_t pin, uint32_t level) { due_pins::note(pin, level); }
int digitalRead(uint32_t pin) { return the_pins.value[pin]; }
void analogWrite(uint32_t pin, uint32_t duty) { due_pins::note(pin, duty); }
void analogWriteResolution(int bits) { the_pins.resolution_bits = bits; }
void analogReadResolution(int) {}
uint32_t analogRead(uint32_t) { return 0; }
uint32_t digitalPinToInterrupt(uint32_t pin) { return pin; }
void attachInterrupt(uint32_t pin, void (*callback)(), uint32_t) { the_pins.on_edge[pin] = callback; }
void noInterrupts() {}
void interrupts() {}
uint32_t millis() { return static_cast<uint32_t>(the_pins.now_us / 1000); }
uint32_t micros() { return static_cast<uint32_t>(the_pins.now_us); }
void watchdogEnable(uint32_t ms) {
  watchdogReset();
  the_pins.watchdog_ms = ms;
}
void watchdogReset() {
  const bool is_late = the_pins.now_us - the_pins.watchdog_fed_at_us > the_pins.watchdog_ms * uint64_t{1000};
  if (is_late) ++the_pins.restarts;
  the_pins.watchdog_fed_at_us = the_pins.now_us;
}

void SerialPort::begin(uint32_t) {}
int SerialPort::available() { return static_cast<int>(the_pins.from_host.size()); }
int SerialPort::read() {
  if (the_pins.from_host.empty()) return -1;
  const int byte = the_pins.from_host.front();
  the_pins.from_host.pop_front();
  return byte;
}
int SerialPort::availableForWrite() { return 127; }
size_t SerialPort::write(const uint8_t* data, size_t size) {
  the_pins.to_host.append(reinterpret_cast<const char*>(data), size);
  return size;
}
