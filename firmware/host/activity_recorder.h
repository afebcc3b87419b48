// ActivityRecorder: when the board last received a message and when its wheels last rolled, by the board's clock.
#pragma once

#include <stdint.h>

#include "world.h"

namespace hostlink {

class ActivityRecorder {
 public:
  // On each pass of the loop; `delivered` counts the messages that the firmware received.
  void update(const World& world, uint32_t delivered, uint32_t now_ms) {
    if (delivered != delivered_) got_at_ms_ = now_ms;
    delivered_ = delivered;
    if (rolls(world.left()) || rolls(world.right())) rolled_at_ms_ = now_ms;
  }

  uint32_t got_at_ms() const { return got_at_ms_; }
  uint32_t rolled_at_ms() const { return rolled_at_ms_; }

 private:
  static bool rolls(const DriveTrain& wheel) {
    const double standing_ticks_s = 2.0;  // 2.5 mm/s
    return wheel.speed_ticks_s() > standing_ticks_s || wheel.speed_ticks_s() < -standing_ticks_s;
  }

  uint32_t delivered_ = 0;
  uint32_t got_at_ms_ = 0;
  uint32_t rolled_at_ms_ = 0;
};

}  // namespace hostlink
