#include "drive_train.h"

#include <float.h>
#include <math.h>

namespace hostlink {

namespace {

const double kEdgesPerTick = 2.0;  // a rising and a falling one
const double kBeforeAnEdgeTicks = (1.0 - DBL_EPSILON) / kEdgesPerTick;
const double kNoiseM = 0.01;  // rolled between two numbers of the slip's noise

}  // namespace

void DriveTrain::be(const WheelParameters& parameters, uint64_t seed) {
  wheel_ = parameters;
  random_ = RandomNumbers(seed, stream_);
}

void DriveTrain::grip(double ticks_s) {
  is_gripped_ = true;
  speed_rad_s_ = ticks_s * kTurnRad / wheel_.ticks_per_turn;
}

double DriveTrain::step(double pwm, double brake_share, double load_pwm, double dt_s) {
  is_stuck_ = is_stuck_ || (is_broken_ && pwm != 0.0);
  if (is_stuck_) {
    pwm = kFullPwm;
    brake_share = 0.0;
  }
  const double before_m_s = speed_m_s();
  const double rolled_rad = roll(pwm, brake_share, load_pwm, dt_s);
  if (rolled_rad == 0.0) return 0.0;
  count(rolled_rad);
  return over_floor(rolled_rad * wheel_.radius_m, before_m_s);
}

double DriveTrain::roll(double pwm, double brake_share, double load_pwm, double dt_s) {
  if (is_gripped_) return speed_rad_s_ * dt_s;
  if (pwm == 0.0 && speed_rad_s_ == 0.0) return 0.0;
  const double target_rad_s = aimed_rad_s(pwm, load_pwm);
  if (target_rad_s != 0.0) {
    const bool is_too_fast =
        speed_rad_s_ * target_rad_s > target_rad_s * target_rad_s;  // a PWM pushes and does not brake
    return approach(target_rad_s, is_too_fast ? wheel_.coast_constant_s : wheel_.rise_constant_s, dt_s);
  }
  const double constant_s =
      1.0 / (brake_share / wheel_.brake_constant_s + (1.0 - brake_share) / wheel_.coast_constant_s);
  return slow_down(constant_s, load_pwm / kFullPwm * wheel_.full_speed_rad_s + wheel_.friction_rad_s, dt_s);
}

double DriveTrain::aimed_rad_s(double pwm, double load_pwm) const {
  const double duty = fabs(pwm) - load_pwm;
  const double dead_pwm = wheel_.dead_zone_pwm;
  if (duty < dead_pwm || duty <= 0.0) return 0.0;
  const double share = wheel_.has_jump != 0.0 ? duty / kFullPwm : (duty - dead_pwm) / (kFullPwm - dead_pwm);
  return (pwm > 0.0 ? 1.0 : -1.0) * share * wheel_.full_speed_rad_s;
}

// Exact solution of the first-order lag over the step, so that the result does not depend on the length of the step.
double DriveTrain::approach(double target_rad_s, double constant_s, double dt_s) {
  const double decay = exp(-dt_s / constant_s);
  const double ahead_rad_s = speed_rad_s_ - target_rad_s;
  speed_rad_s_ = target_rad_s + ahead_rad_s * decay;
  return target_rad_s * dt_s + ahead_rad_s * constant_s * (1.0 - decay);
}

// Like friction in the other direction, until the wheel stops.
double DriveTrain::slow_down(double constant_s, double friction_rad_s, double dt_s) {
  if (friction_rad_s == 0.0) return approach(0.0, constant_s, dt_s);
  const double backwards_rad_s = speed_rad_s_ < 0.0 ? friction_rad_s : -friction_rad_s;
  const double until_stand_s = constant_s * log((fabs(speed_rad_s_) + friction_rad_s) / friction_rad_s);
  if (until_stand_s > dt_s) return approach(backwards_rad_s, constant_s, dt_s);
  const double rolled_rad = approach(backwards_rad_s, constant_s, until_stand_s);
  speed_rad_s_ = 0.0;
  return rolled_rad;
}

void DriveTrain::count(double rolled_rad) {
  rolled_rad_ += rolled_rad;
  part_ticks_ += rolled_rad * wheel_.ticks_per_turn / kTurnRad;
  const double passed = floor(part_ticks_ * kEdgesPerTick);
  part_ticks_ -= passed / kEdgesPerTick;
  // Without this, rounding onto the edge that the wheel has just passed would count that edge again in each step.
  if (part_ticks_ > kBeforeAnEdgeTicks) part_ticks_ = kBeforeAnEdgeTicks;
  if (!is_deaf_) edges_ += static_cast<uint32_t>(fabs(passed));
}

// Distance of the robot for a distance of the wheel: less while it speeds up, more while it slows down.
double DriveTrain::over_floor(double rolled_m, double before_m_s) {
  const double gained = (speed_m_s() * speed_m_s() - before_m_s * before_m_s) / 2.0;
  const double share_s2_m = gained > 0.0 ? wheel_.slip_accelerating_s2_m : wheel_.slip_braking_s2_m;
  double moved_m = rolled_m - share_s2_m * gained * (rolled_m > 0.0 ? 1.0 : -1.0);
  if (wheel_.slip_noise_m == 0.0) return moved_m;
  part_noise_m_ += fabs(rolled_m);
  while (part_noise_m_ >= kNoiseM) {
    part_noise_m_ -= kNoiseM;
    moved_m += wheel_.slip_noise_m * sqrt(kNoiseM) * random_.normal();
  }
  return moved_m;
}

}  // namespace hostlink
