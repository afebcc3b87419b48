// What the robot needs of a board. Implementations: board/ (the Due), firmware/host, firmware/qemu.
#pragma once

#include <ros/link.h>
#include <stddef.h>
#include <stdint.h>

#include "constants.h"

namespace hostlink {

class Hal : public ros::Link {
 public:
  virtual uint32_t micros() = 0;                                // wraps after 71.6 minutes
  virtual void drive(int16_t left_pwm, int16_t right_pwm) = 0;  // signed, -4095..4095; 0 brakes as hard as it can
  virtual void edges(uint32_t& left, uint32_t& right) = 0;      // of the encoders, rising and falling; wrap
  virtual float battery_v() { return kNotMeasured; }            // of the motors' supply; NaN: not measured
  virtual bool was_hung() { return false; }                     // whether the hardware watchdog restarted the board

 protected:
  ~Hal() {}
};

}  // namespace hostlink
