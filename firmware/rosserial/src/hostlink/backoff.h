// How long to wait before the next attempt: doubles up to a limit, with jitter, so that a fleet does not come back in
// step.
#pragma once

#include <stdint.h>

namespace hostlink {

class Backoff {
 public:
  static const uint32_t kFirst_ms = 200;
  static const uint32_t kLongest_ms = 1600;  // a restarted host drives the robot again within 3 s

  explicit Backoff(uint32_t seed) : random_(seed | 1u) {}

  void reset() { next_ms_ = kFirst_ms; }
  // Something that differs from board to board, as the microseconds of an event of the network.
  void stir(uint32_t bits) { random_ = (random_ ^ bits) | 1u; }

  // Between the half and the whole of the step.
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
