// What the three inputs of a motor's channel on the shield are given for a PWM with a sign. On the shield's L298 the
// PWM is the enable: BRAKE HIGH shorts the motor only while the PWM is on, with a PWM of 0 it runs free.
#pragma once

#include "constants.h"

namespace hostlink {

struct MotorLevels {
  bool direction;  // true: HIGH
  bool brake;
  int16_t duty;  // of the PWM, 0..4095
};

// 0 brakes as hard as the shield can. A reversed motor is mounted mirrored: it rolls forwards with DIR LOW.
inline MotorLevels motor_levels(int16_t pwm, bool is_reversed) {
  const int16_t size = pwm < 0 ? static_cast<int16_t>(-pwm) : pwm;
  const bool is_forward = pwm >= 0;
  MotorLevels levels = {is_forward != is_reversed, pwm == 0, pwm == 0 ? kPwmMax : size};
  return levels;
}

}  // namespace hostlink
