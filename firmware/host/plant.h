// Plant: two motors with wheels and single-channel encoders, first-order as the robot's own. The C++ twin of
// hostlink/sim/drive_train.py, but that a PWM of 0 brakes, as the board does; the same class stands behind the native
// board and the emulated one.
#pragma once

#include <stdint.h>

namespace hostlink {

class Motor {
 public:
  float step(int16_t pwm, float dt_s);       // returns how far it rolled, in ticks with their sign
  uint32_t edges() const { return edges_; }  // wraps
  float speed_ticks_s() const { return speed_ticks_s_; }

 private:
  float speed_ticks_s_ = 0.0f;
  float part_ticks_ = 0.0f;  // rolled since the last edge
  uint32_t edges_ = 0;
};

class Plant {
 public:
  void drive(int16_t left_pwm, int16_t right_pwm) {
    left_pwm_ = left_pwm;
    right_pwm_ = right_pwm;
  }
  // Let time pass, in steps that a motor can be computed in.
  void run_until(uint32_t now_us);

  const Motor& left() const { return left_; }
  const Motor& right() const { return right_; }
  // Where the robot truly is: what its odometry tries to tell.
  double x_m() const { return x_m_; }
  double y_m() const { return y_m_; }
  double rolled_m() const { return rolled_m_; }

 private:
  void move(double left_m, double right_m);

  Motor left_;
  Motor right_;
  int16_t left_pwm_ = 0;
  int16_t right_pwm_ = 0;
  uint32_t at_us_ = 0;
  bool has_begun_ = false;
  double x_m_ = 0.0;
  double y_m_ = 0.0;
  double theta_rad_ = 0.0;
  double rolled_m_ = 0.0;  // by the robot's middle, forwards and backwards
};

}  // namespace hostlink
