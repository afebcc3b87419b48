#include "wheel.h"

namespace hostlink {

void MinimumJerk::aim(float target) {
  if (target == target_) return;
  from_ = value_;
  target_ = target;
  elapsed_s_ = 0.0f;
  const float change = target - value_;
  length_s_ = (change < 0.0f ? -change : change) * kSecondsPerTick;
}

void MinimumJerk::halt() {
  value_ = target_ = from_ = 0.0f;
  elapsed_s_ = length_s_ = 0.0f;
}

float MinimumJerk::step(float dt_s) {
  elapsed_s_ += dt_s;
  if (!(elapsed_s_ < length_s_)) {  // also when there is no way to go: no division by zero
    value_ = target_;
    elapsed_s_ = length_s_;
    return value_;
  }
  const float s = elapsed_s_ / length_s_;
  value_ = from_ + (target_ - from_) * s * s * s * (10.0f + s * (-15.0f + 6.0f * s));
  return value_;
}

float Pid::step(float wanted_ticks_s, float measured_ticks_s, float dt_s) {
  const float limit = static_cast<float>(kPwmMax);
  const float error = wanted_ticks_s - measured_ticks_s - gains_.feedback * output_ / limit * kTopSpeedTicksS;
  const float integral = integral_ + error * dt_s;
  const float derivative = (error - previous_error_) / dt_s;
  const float free = gains_.kp * error + gains_.ki * integral + gains_.kd * derivative;
  output_ = clamp(free, -limit, limit);
  const bool winds_up = free != output_ && (free > 0.0f) == (error > 0.0f);
  if (!winds_up) integral_ = integral;
  previous_error_ = error;
  return output_;
}

void Pid::reset() { output_ = integral_ = previous_error_ = 0.0f; }

int16_t motor_output(float wanted) {
  const float size = wanted < 0.0f ? -wanted : wanted;
  if (!(size > static_cast<float>(kPwmNothing))) return 0;  // NaN compares false
  const float bounded = clamp(size, static_cast<float>(kPwmLeast), static_cast<float>(kPwmMax));
  const int16_t pwm = static_cast<int16_t>(bounded + 0.5f);
  return wanted < 0.0f ? static_cast<int16_t>(-pwm) : pwm;
}

void Wheel::aim(float ticks_s) {
  if (ticks_s == 0.0f) {
    set_point_.halt();
  } else {
    set_point_.aim(ticks_s);
  }
}

int32_t Wheel::step(uint32_t edges, float dt_s) {
  const int32_t rolled = direction_ * static_cast<int32_t>(edges);
  const float edges_s = static_cast<float>(edges) / dt_s;
  speed_ticks_s_ += kFilterWeight * (static_cast<float>(direction_) * edges_s - speed_ticks_s_);
  const float wanted = set_point_.step(dt_s);
  float output = 0.0f;
  if (wanted == 0.0f && set_point_.target() == 0.0f) {
    pid_.reset();
  } else {
    output = pid_.step(wanted, speed_ticks_s_, dt_s);
  }
  pwm_ = motor_output(output);
  // A wheel that was told to reverse rolls on for a while; its edges count the old way until it has come to rest.
  if (pwm_ * direction_ < 0 && edges_s < kStandingTicksS) direction_ = static_cast<int8_t>(-direction_);
  return rolled;
}

}  // namespace hostlink
