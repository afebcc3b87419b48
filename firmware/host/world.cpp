#include "world.h"

#include <math.h>

namespace hostlink {

namespace {

const int kBits = 12;             // of the firmware's duties
const double kSmallRad = 1e-8;    // below it an arc and its chord have the same length
const double kStandingM = 0.001;  // the motion that stands for the PWM of a stopped wheel
const uint32_t kStepUs = 1000;
const uint32_t kMostUs = 1000000;  // a board that was paused does not roll on for the time it missed

// Direction of a wheel: its rolling direction; for a stopped wheel the direction in which it is driven.
double course_m(const DriveTrain& wheel, double pwm) {
  if (wheel.speed_rad_s() != 0.0) return wheel.speed_m_s();
  return pwm == 0.0 ? 0.0 : (pwm > 0.0 ? kStandingM : -kStandingM);
}

// Output of the pin for a duty: the core drops the low bits.
double on_pin(int16_t duty, double bits) {
  const int whole = static_cast<int>(bits);
  const double step = ldexp(1.0, kBits - whole);
  const double top = ldexp(1.0, whole) - 1.0;
  return floor(static_cast<double>(duty) / step) / top * kFullPwm;
}

}  // namespace

void World::be(const WorldParameters& parameters) {
  parameters_ = parameters;
  const uint64_t seed = static_cast<uint64_t>(parameters.seed);
  left_.be(parameters.left, seed);
  right_.be(parameters.right, seed);
  const CasterParameters caster = {parameters.caster_arm_m, parameters.caster_trail_m, parameters.caster_twist_rad,
                                   parameters.caster_random};
  caster_.be(caster, seed);
  set(left_levels_, right_levels_);
}

void World::set(const MotorLevels& left, const MotorLevels& right) {
  left_levels_ = left;
  right_levels_ = right;
  left_duty_ = on_pin(left.duty, parameters_.pwm_bits);
  right_duty_ = on_pin(right.duty, parameters_.pwm_bits);
}

double World::battery_v() const {
  const double left = left_levels_.brake ? 0.0 : left_duty_;  // a shorted motor draws nothing
  const double right = right_levels_.brake ? 0.0 : right_duty_;
  const double volts = parameters_.battery_v - parameters_.battery_sag_v * (left + right) / 2.0 / kFullPwm;
  return volts > 0.0 ? volts : 0.0;
}

void World::step(double dt_s) {
  const double scale = battery_v() / parameters_.rated_v;
  const double left_pwm = pushed_pwm(left_levels_, left_duty_, kIsReversedLeft) * scale;
  const double right_pwm = pushed_pwm(right_levels_, right_duty_, kIsReversedRight) * scale;
  const double load = load_pwm(left_pwm, right_pwm);
  const double left_m = left_.step(left_pwm, left_levels_.brake ? left_duty_ / kFullPwm : 0.0, load, dt_s);
  const double right_m = right_.step(right_pwm, right_levels_.brake ? right_duty_ / kFullPwm : 0.0, load, dt_s);
  move(left_m, right_m);
}

void World::run_until(uint32_t now_us) {
  if (!has_begun_ || now_us - at_us_ > kMostUs) {
    has_begun_ = true;
    at_us_ = now_us;
  }
  while (now_us - at_us_ >= kStepUs) {
    at_us_ += kStepUs;
    step(static_cast<double>(kStepUs) * 1e-6);
  }
}

void World::shove(double forward_m, double sideways_m, double turned_rad) {
  const double along = cos(pose_.theta_rad);
  const double across = sin(pose_.theta_rad);
  pose_.x_m += forward_m * along - sideways_m * across;
  pose_.y_m += forward_m * across + sideways_m * along;
  pose_.theta_rad += turned_rad;
}

double World::pushed_pwm(const MotorLevels& levels, double duty, bool is_mirrored) {
  if (levels.brake) return 0.0;
  return levels.direction != is_mirrored ? duty : -duty;
}

double World::load_pwm(double left_pwm, double right_pwm) const {
  if (parameters_.caster_pwm == 0.0) return parameters_.floor_pwm;
  const double left_m = course_m(left_, left_pwm);
  const double right_m = course_m(right_, right_pwm);
  const double against = caster_.resistance((left_m + right_m) / 2.0, (right_m - left_m) / parameters_.track_m);
  return parameters_.floor_pwm + parameters_.caster_pwm * against;
}

void World::move(double left_m, double right_m) {
  if (left_m == 0.0 && right_m == 0.0) return;
  const double forward_m = (left_m + right_m) / 2.0;
  double turned_rad = (right_m - left_m) / parameters_.track_m;
  if (parameters_.caster_pwm != 0.0 || parameters_.caster_twist_rad != 0.0) {
    turned_rad += caster_.step(forward_m, turned_rad);
  }
  const double half_rad = turned_rad / 2.0;
  const double chord_m = fabs(half_rad) < kSmallRad ? forward_m : forward_m * sin(half_rad) / half_rad;
  pose_.x_m += chord_m * cos(pose_.theta_rad + half_rad);
  pose_.y_m += chord_m * sin(pose_.theta_rad + half_rad);
  pose_.theta_rad += turned_rad;
  rolled_m_ += fabs(forward_m);
}

}  // namespace hostlink
