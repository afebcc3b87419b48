// DriveTrain: a motor on the shield, its gear, its wheel, its grip on the floor and its single-channel encoder.
#pragma once

#include <stdint.h>

#include "random_numbers.h"
#include "world_parameters.h"

namespace hostlink {

class DriveTrain {
 public:
  explicit DriveTrain(uint64_t stream) : random_(1, stream), stream_(stream) {}
  void be(const WheelParameters& parameters, uint64_t seed);

  // Turn the wheel by hand at this speed, or block it (0), independent of the motor.
  void grip(double ticks_s);
  void release() { is_gripped_ = false; }
  void deafen(bool is_so) { is_deaf_ = is_so; }  // dead encoder
  void break_driver() { is_broken_ = true; }     // the next drive makes it run at full speed for good

  // Let time pass with a signed PWM (forwards positive, at the rated voltage; below 0 backwards), shorted for this
  // share of the time, against a load. Returns the distance by which it moved the robot over the floor, in metres.
  double step(double pwm, double brake_share, double load_pwm, double dt_s);

  uint32_t edges() const { return edges_; }  // rising and falling: two a tick; wraps
  double speed_rad_s() const { return speed_rad_s_; }
  double speed_m_s() const { return speed_rad_s_ * wheel_.radius_m; }
  double speed_ticks_s() const { return speed_rad_s_ * wheel_.ticks_per_turn / kTurnRad; }
  double rolled_ticks() const { return rolled_rad_ * wheel_.ticks_per_turn / kTurnRad; }
  double rolled_rad() const { return rolled_rad_; }  // signed: the true value of the encoder

 private:
  double aimed_rad_s(double pwm, double load_pwm) const;
  double roll(double pwm, double brake_share, double load_pwm, double dt_s);
  double approach(double target_rad_s, double constant_s, double dt_s);
  double slow_down(double constant_s, double friction_rad_s, double dt_s);
  void count(double rolled_rad);
  double over_floor(double rolled_m, double before_m_s);

  WheelParameters wheel_;
  RandomNumbers random_;
  uint64_t stream_;
  bool is_gripped_ = false;
  bool is_deaf_ = false;
  bool is_broken_ = false;
  bool is_stuck_ = false;
  double speed_rad_s_ = 0.0;
  double rolled_rad_ = 0.0;
  double part_ticks_ = 0.0;    // distance behind the last edge in the forward direction: edges are half a tick apart
  double part_noise_m_ = 0.0;  // distance since the last noise
  uint32_t edges_ = 0;
};

}  // namespace hostlink
