#include "plant.h"

#include <math.h>

namespace hostlink {

namespace {

const float kFullPwm = 4095.0f;
const float kFullSpeedTicksS = 280.0f;
const float kTimeConstantS = 0.1f;
const int16_t kStictionPwm = 350;  // below it a wheel does not move
const uint32_t kStepUs = 1000;
const uint32_t kMostUs = 1000000;  // a board that was stopped does not roll on for what it missed

}  // namespace

void Motor::step(int16_t pwm, float dt_s) {
  const bool moves = pwm >= kStictionPwm || pwm <= -kStictionPwm;
  const float target = moves ? static_cast<float>(pwm) / kFullPwm * kFullSpeedTicksS : 0.0f;
  const float decay = expf(-dt_s / kTimeConstantS);
  const float rolled = target * dt_s + (speed_ticks_s_ - target) * kTimeConstantS * (1.0f - decay);
  speed_ticks_s_ = target + (speed_ticks_s_ - target) * decay;
  part_ticks_ += rolled < 0.0f ? -rolled : rolled;
  while (part_ticks_ >= 1.0f) {
    part_ticks_ -= 1.0f;
    ++edges_;
  }
}

void Plant::run_until(uint32_t now_us) {
  if (!has_begun_ || now_us - at_us_ > kMostUs) {
    has_begun_ = true;
    at_us_ = now_us;
  }
  while (now_us - at_us_ >= kStepUs) {
    at_us_ += kStepUs;
    const float dt_s = static_cast<float>(kStepUs) * 1e-6f;
    left_.step(left_pwm_, dt_s);
    right_.step(right_pwm_, dt_s);
  }
}

}  // namespace hostlink
