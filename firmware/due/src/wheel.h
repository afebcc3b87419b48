// One wheel: set-point along a minimum-jerk curve, PID with a feedback term, motor output, ticks with their sign.
// No clock and no pin: dt comes in.
#pragma once

#include <stdint.h>

#include "constants.h"

namespace hostlink {

// A set-point that goes from where it is to a target without a jerk.
class MinimumJerk {
 public:
  void aim(float target);  // the same target again changes nothing
  void halt();             // be at zero now
  float step(float dt_s);
  float value() const { return value_; }
  float target() const { return target_; }

 private:
  float value_ = 0.0f;
  float target_ = 0.0f;
  float from_ = 0.0f;
  float elapsed_s_ = 0.0f;
  float length_s_ = 0.0f;
};

// e = wanted - measured - feedback * last output; no winding up against the limit.
class Pid {
 public:
  explicit Pid(const Gains& gains) : gains_(gains) {}
  float step(float wanted_ticks_s, float measured_ticks_s, float dt_s);
  void reset();
  void tune(const Gains& gains) { gains_ = gains; }
  const Gains& gains() const { return gains_; }

 private:
  Gains gains_;
  float output_ = 0.0f;
  float integral_ = 0.0f;
  float previous_error_ = 0.0f;
};

// Nothing up to 10, at least 700 above, 4095 at the most; what is no number is nothing.
int16_t motor_output(float wanted);

class Wheel {
 public:
  explicit Wheel(const Gains& gains) : pid_(gains) {}

  void aim(float ticks_s);  // zero is no ramp but a stop
  void halt() { set_point_.halt(); }
  // One turn of the loop with the edges that the encoder counted in it; returns how far the wheel rolled, in ticks.
  int32_t step(uint32_t edges, float dt_s);

  int16_t pwm() const { return pwm_; }
  float speed_ticks_s() const { return speed_ticks_s_; }
  float set_point_ticks_s() const { return set_point_.value(); }
  Pid& pid() { return pid_; }

 private:
  MinimumJerk set_point_;
  Pid pid_;
  float speed_ticks_s_ = 0.0f;
  int16_t pwm_ = 0;
  int8_t direction_ = 1;  // the sign that the edges are given: one channel has none of its own
};

}  // namespace hostlink
