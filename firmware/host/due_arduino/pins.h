// Pins: record of what the Due's program wrote to its pins, and source of its inputs, for the tests of src/board/.
#pragma once

#include <stdint.h>

#include <deque>
#include <string>
#include <vector>

namespace due_pins {

const size_t kPins = 54;
const size_t kLogMax = 4096;
const uint32_t kWatchdogAtResetMs = 16000;  // SAM3X: WDT_MR is 0x3FFF2FFF after a reset

struct Write {
  uint8_t pin;
  uint16_t value;  // a level, or a duty of `resolution_bits`
};

struct Pins {
  uint64_t now_us = 0;
  uint16_t value[kPins] = {};  // the last level or duty; a pin that was never written is low
  void (*on_edge[kPins])() = {};
  int resolution_bits = 8;
  std::vector<Write> writes;  // the first kLogMax since it was cleared
  std::deque<uint8_t> from_host;
  std::string to_host;
  uint32_t watchdog_ms = kWatchdogAtResetMs;
  uint64_t watchdog_fed_at_us = 0;
  uint32_t restarts = 0;  // that the watchdog would have caused
};

Pins& pins();
void power_up();  // as after a reset, except the program's static memory

}  // namespace due_pins
