// Delay before the next attempt: doubles up to a limit, with jitter, so that the boards of a fleet do not reconnect at
// the same moment.
#pragma once

#include <stdint.h>

namespace hostlink {

class Backoff {
 public:
  static const uint32_t kFirst_ms = 200;
  static const uint32_t kLongest_ms = 1600;  // a restarted host drives the robot again within 3 s

  explicit Backoff(uint32_t seed) : random_(seed | 1u) {}

  void reset() { next_ms_ = kFirst_ms; }
  // A number that differs from board to board, for example the microseconds of a network event.
  void stir(uint32_t bits) { random_ = (random_ ^ bits) | 1u; }

  // Between half of the step and the whole step.
  uint32_t next_ms() {
    const uint32_t step_ms = next_ms_;
    next_ms_ = step_ms * 2 < kLongest_ms ? step_ms * 2 : static_cast<uint32_t>(kLongest_ms);
    return step_ms / 2 + random() % (step_ms / 2 + 1);
  }

 private:
  uint32_t random() {  // xorshift32
    random_ ^= random_ << 13;
    random_ ^= random_ >> 17;
    random_ ^= random_ << 5;
    return random_;
  }

  uint32_t random_;
  uint32_t next_ms_ = kFirst_ms;
};

}  // namespace hostlink
