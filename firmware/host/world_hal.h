// WorldHal: the part of a board's Hal that is the world: motors, encoders, battery. Each board has its own clock and
// UART.
#pragma once

#include <stdint.h>

#include "../due/src/hal.h"
#include "world.h"

namespace hostlink {

class WorldHal : public Hal {
 public:
  void drive(int16_t left_pwm, int16_t right_pwm) override { world_.drive(left_pwm, right_pwm); }

  void edges(uint32_t& left, uint32_t& right) override {
    left = world_.left().edges();
    right = world_.right().edges();
  }

  float battery_v() override { return static_cast<float>(world_.battery_v()); }

 protected:
  World world_;
};

}  // namespace hostlink
