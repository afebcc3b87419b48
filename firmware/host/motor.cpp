#include "motor.h"

#include <math.h>

namespace hostlink {

namespace {

const float kFullPwm = static_cast<float>(kPwmMax);
const float kCasterTicks = 40.0f;  // 5 cm: the caster has swung round

}  // namespace

void Motor::grip(float ticks_s) {
  is_gripped_ = true;
  speed_ticks_s_ = ticks_s;
}

float Motor::step(const MotorLevels& levels, float dt_s) {
  const float target = levels.brake ? 0.0f : aimed_ticks_s(levels);
  float rolled = 0.0f;
  if (is_gripped_) {
    rolled = speed_ticks_s_ * dt_s;
  } else if (target != 0.0f) {
    const bool is_too_fast = speed_ticks_s_ * target > target * target;  // a PWM pushes, it does not brake
    rolled = approach(target, is_too_fast ? world_.coast_constant_s : world_.time_constant_s, dt_s);
  } else {
    const float on = levels.brake ? static_cast<float>(levels.duty) / kFullPwm : 0.0f;  // the enable's share of time
    rolled = slow_down(1.0f / (on / world_.brake_constant_s + (1.0f - on) / world_.coast_constant_s), dt_s);
  }
  count(rolled);
  return rolled;
}

float Motor::aimed_ticks_s(const MotorLevels& levels) const {
  const float sign = levels.direction != is_mirrored_ ? 1.0f : -1.0f;
  const bool swings = since_turn_ticks_ < kCasterTicks || static_cast<float>(sense_) != sign;
  const float duty = static_cast<float>(levels.duty) - (swings ? world_.caster_pwm : 0.0f);
  const float dead = world_.dead_zone_pwm;
  if (duty < dead || duty <= 0.0f) return 0.0f;
  const float share = world_.has_jump ? duty / kFullPwm : (duty - dead) / (kFullPwm - dead);
  return sign * share * world_.full_speed_ticks_s;
}

// The exact solution of the first-order lag over the step, so that the result does not depend on its length.
float Motor::approach(float target_ticks_s, float constant_s, float dt_s) {
  const float decay = expf(-dt_s / constant_s);
  const float ahead = speed_ticks_s_ - target_ticks_s;
  speed_ticks_s_ = target_ticks_s + ahead * decay;
  return target_ticks_s * dt_s + ahead * constant_s * (1.0f - decay);
}

// As if friction drove it backwards, until it stands.
float Motor::slow_down(float constant_s, float dt_s) {
  const float speed = fabsf(speed_ticks_s_);
  const float friction = world_.friction_ticks_s;
  const float sign = speed_ticks_s_ < 0.0f ? -1.0f : 1.0f;
  const float until_stand_s = friction > 0.0f ? constant_s * logf((speed + friction) / friction) : dt_s + 1.0f;
  if (until_stand_s > dt_s) return approach(-sign * friction, constant_s, dt_s);
  const float rolled = approach(-sign * friction, constant_s, until_stand_s);
  speed_ticks_s_ = 0.0f;
  return rolled;
}

void Motor::count(float rolled_ticks) {
  const float size = fabsf(rolled_ticks);
  const int8_t sense = static_cast<int8_t>(rolled_ticks > 0.0f ? 1 : (rolled_ticks < 0.0f ? -1 : 0));
  if (sense != 0 && sense != sense_) since_turn_ticks_ = 0.0f;
  if (sense != 0) sense_ = sense;
  since_turn_ticks_ += size;
  part_ticks_ += rolled_ticks;
  for (; part_ticks_ >= kTicksPerEdge; part_ticks_ -= kTicksPerEdge) ++edges_;
  for (; part_ticks_ < 0.0f; part_ticks_ += kTicksPerEdge) ++edges_;
}

}  // namespace hostlink
