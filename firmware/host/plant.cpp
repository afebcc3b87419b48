#include "plant.h"

#include <math.h>

namespace hostlink {

namespace {

const float kFullPwm = 4095.0f;
const float kFullSpeedTicksS = 280.0f;
const float kTimeConstantS = 0.1f;
const float kBrakeConstantS = 0.02f;  // a motor that is short-circuited, behind its 75:1 gear
const int16_t kStictionPwm = 350;     // below it a wheel does not move
const double kMetresPerTick = 2.0 * 3.14159265358979323846 * 0.045 / 230.4;
const double kSeparationM = 0.210;
const uint32_t kStepUs = 1000;
const uint32_t kMostUs = 1000000;  // a board that was stopped does not roll on for what it missed

}  // namespace

float Motor::step(int16_t pwm, float dt_s) {
  const bool moves = pwm >= kStictionPwm || pwm <= -kStictionPwm;
  const float target = moves ? static_cast<float>(pwm) / kFullPwm * kFullSpeedTicksS : 0.0f;
  const float constant_s = pwm == 0 ? kBrakeConstantS : kTimeConstantS;
  const float decay = expf(-dt_s / constant_s);
  const float rolled = target * dt_s + (speed_ticks_s_ - target) * constant_s * (1.0f - decay);
  speed_ticks_s_ = target + (speed_ticks_s_ - target) * decay;
  part_ticks_ += rolled < 0.0f ? -rolled : rolled;
  while (part_ticks_ >= 1.0f) {
    part_ticks_ -= 1.0f;
    ++edges_;
  }
  return rolled;
}

void Plant::run_until(uint32_t now_us) {
  if (!has_begun_ || now_us - at_us_ > kMostUs) {
    has_begun_ = true;
    at_us_ = now_us;
  }
  while (now_us - at_us_ >= kStepUs) {
    at_us_ += kStepUs;
    const float dt_s = static_cast<float>(kStepUs) * 1e-6f;
    const double left_m = static_cast<double>(left_.step(left_pwm_, dt_s)) * kMetresPerTick;
    const double right_m = static_cast<double>(right_.step(right_pwm_, dt_s)) * kMetresPerTick;
    move(left_m, right_m);
  }
}

// A millisecond is short enough for a straight line along the middle heading.
void Plant::move(double left_m, double right_m) {
  const double forward_m = (left_m + right_m) / 2.0;
  const double turned_rad = (right_m - left_m) / kSeparationM;
  x_m_ += forward_m * cos(theta_rad_ + turned_rad / 2.0);
  y_m_ += forward_m * sin(theta_rad_ + turned_rad / 2.0);
  theta_rad_ += turned_rad;
  rolled_m_ += fabs(forward_m);
}

}  // namespace hostlink
