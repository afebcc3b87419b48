// ActivityRecorder: when the board last got a message and when its wheels last rolled, by the board's own clock.
#pragma once

#include <stdint.h>

#include "plant.h"

namespace hostlink {

class ActivityRecorder {
 public:
  // On each pass of the loop; `delivered` counts the messages that the firmware got.
  void see(const Plant& plant, uint32_t delivered, uint32_t now_ms) {
    if (delivered != delivered_) got_at_ms_ = now_ms;
    delivered_ = delivered;
    if (rolls(plant.left()) || rolls(plant.right())) rolled_at_ms_ = now_ms;
  }

  uint32_t got_at_ms() const { return got_at_ms_; }
  uint32_t rolled_at_ms() const { return rolled_at_ms_; }

 private:
  static bool rolls(const Motor& motor) {
    const float standing_ticks_s = 2.0f;  // 2.5 mm/s
    return motor.speed_ticks_s() > standing_ticks_s || motor.speed_ticks_s() < -standing_ticks_s;
  }

  uint32_t delivered_ = 0;
  uint32_t got_at_ms_ = 0;
  uint32_t rolled_at_ms_ = 0;
};

}  // namespace hostlink
