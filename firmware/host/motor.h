// Motor: a motor on the shield, its gear, its wheel and a single-channel encoder. The C++ twin of
// hostlink/sim/drive_train.py; what differs from motor to motor is in MotorWorld.
#pragma once

#include <stdint.h>

#include "../due/src/motor_levels.h"

namespace hostlink {

// The defaults are the robot's; tests draw others.
struct MotorWorld {
  float full_speed_ticks_s = 280.0f;
  float time_constant_s = 0.1f;    // while its PWM pushes it
  float coast_constant_s = 0.3f;   // while nothing pushes it and it runs free
  float brake_constant_s = 0.04f;  // while it is short-circuited, behind its 75:1 gear
  float friction_ticks_s = 24.0f;  // ends a coasting: the speed lost to friction in one time constant
  float dead_zone_pwm = 350.0f;    // less does not turn it
  bool has_jump = true;            // above the dead zone it turns as if there were none; else beginning with nothing
  float caster_pwm = 0.0f;         // the load of the caster while it swings round after a reversal
};

class Motor {
 public:
  explicit Motor(bool is_mirrored) : is_mirrored_(is_mirrored) {}  // mounted so: rolls forwards with DIR LOW
  void be(const MotorWorld& world) { world_ = world; }
  // Somebody turns the wheel by hand, at this speed, or blocks it (0), whatever the motor does.
  void grip(float ticks_s);
  void release() { is_gripped_ = false; }

  // Returns how far the wheel rolled, in ticks with their sign: forwards is positive on both sides.
  float step(const MotorLevels& levels, float dt_s);
  uint32_t edges() const { return edges_; }  // rising and falling: two a tick; wraps
  float speed_ticks_s() const { return speed_ticks_s_; }

 private:
  float aimed_ticks_s(const MotorLevels& levels) const;
  float approach(float target_ticks_s, float constant_s, float dt_s);
  float slow_down(float constant_s, float dt_s);
  void count(float rolled_ticks);

  bool is_mirrored_;
  MotorWorld world_;
  bool is_gripped_ = false;
  float speed_ticks_s_ = 0.0f;
  float part_ticks_ = 0.0f;  // behind the last edge, seen forwards: the edges lie half a tick apart
  uint32_t edges_ = 0;
  int8_t sense_ = 0;            // of the last roll
  float since_turn_ticks_ = 0;  // rolled since its sense changed
};

}  // namespace hostlink
