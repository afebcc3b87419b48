// Plant: the robot's two motors and where it truly is; the same class stands behind the native board and the emulated
// one. Its right motor is mounted mirrored, as the paper's.
#pragma once

#include <stdint.h>

#include "motor.h"

namespace hostlink {

class Plant {
 public:
  // As the board does: what its shield is given for these PWMs.
  void drive(int16_t left_pwm, int16_t right_pwm) {
    set(motor_levels(left_pwm, kIsReversedLeft), motor_levels(right_pwm, kIsReversedRight));
  }
  void set(const MotorLevels& left, const MotorLevels& right) {
    left_levels_ = left;
    right_levels_ = right;
  }
  // Let time pass, in steps that a motor can be computed in.
  void run_until(uint32_t now_us);

  Motor& left() { return left_; }
  Motor& right() { return right_; }
  const Motor& left() const { return left_; }
  const Motor& right() const { return right_; }
  // Where the robot truly is: what its odometry estimates.
  double x_m() const { return x_m_; }
  double y_m() const { return y_m_; }
  double theta_rad() const { return theta_rad_; }
  double rolled_m() const { return rolled_m_; }

 private:
  void move(double left_m, double right_m);

  Motor left_{false};
  Motor right_{true};
  MotorLevels left_levels_ = {false, false, 0};
  MotorLevels right_levels_ = {false, false, 0};
  uint32_t at_us_ = 0;
  bool has_begun_ = false;
  double x_m_ = 0.0;
  double y_m_ = 0.0;
  double theta_rad_ = 0.0;
  double rolled_m_ = 0.0;  // by the robot's middle, forwards and backwards
};

}  // namespace hostlink
