// Levels of the three inputs of one motor channel on the shield, for a signed PWM. On the shield's L298 the PWM is the
// enable: BRAKE HIGH shorts the motor only while the PWM is on. With a PWM of 0 the motor runs free.
#pragma once

#include "constants.h"

namespace hostlink {

struct MotorLevels {
  bool direction;  // true: HIGH
  bool brake;
  int16_t duty;  // of the PWM, 0..4095
};

// 0 brakes with the full force of the shield. A reversed motor is mounted mirrored: it rolls forwards with DIR LOW.
inline MotorLevels motor_levels(int16_t pwm, bool is_reversed) {
  const int16_t size = pwm < 0 ? static_cast<int16_t>(-pwm) : pwm;
  const bool is_forward = pwm >= 0;
  MotorLevels levels = {is_forward != is_reversed, pwm == 0, pwm == 0 ? kPwmMax : size};
  return levels;
}

}  // namespace hostlink
