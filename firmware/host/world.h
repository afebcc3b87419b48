// World: the paper's robot on a floor: battery, motors, wheels, encoders, caster, and the true pose. Pure: time is
// an argument. The native board, the emulated board, simulated robots, the tests and the laboratory drive this one.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "../due/src/motor_levels.h"
#include "caster.h"
#include "drive_train.h"
#include "world_parameters.h"

namespace hostlink {

struct TruePose {
  double x_m = 0.0;
  double y_m = 0.0;
  double theta_rad = 0.0;  // not wrapped: whole turns are kept
};

class World {
 public:
  World() { be(parameters_); }
  explicit World(const WorldParameters& parameters) { be(parameters); }
  void be(const WorldParameters& parameters);  // change the parameters from now on; pose and edges stay

  // Input of the motors until the next call: through the board with these PWMs, or pin by pin.
  void drive(int16_t left_pwm, int16_t right_pwm) {
    set(motor_levels(left_pwm, kIsReversedLeft), motor_levels(right_pwm, kIsReversedRight));
  }
  void set(const MotorLevels& left, const MotorLevels& right);

  void step(double dt_s);           // lets time pass
  void run_until(uint32_t now_us);  // the same in steps of a millisecond, by a clock that wraps
  // The robot is pushed over the floor: wheels and encoders do not turn.
  void shove(double forward_m, double sideways_m, double turned_rad);

  // Each wheel: grip (turned or blocked by hand), release, deafen (dead encoder), break_driver; edges and speeds.
  DriveTrain& left() { return left_; }
  DriveTrain& right() { return right_; }
  const DriveTrain& left() const { return left_; }
  const DriveTrain& right() const { return right_; }

  // Drive of a motor, forwards positive; 0 while it brakes or runs free.
  int16_t left_pwm() const { return signed_pwm(left_levels_, kIsReversedLeft); }
  int16_t right_pwm() const { return signed_pwm(right_levels_, kIsReversedRight); }
  const TruePose& pose() const { return pose_; }               // of the middle between the wheels
  double rolled_m() const { return rolled_m_; }                // of the same point, forwards and backwards
  double battery_v() const;                                    // at the motors, now
  double caster_rad() const { return caster_.heading_rad(); }  // rolling direction of its wheel, 0: forwards

 private:
  static int16_t signed_pwm(const MotorLevels& levels, bool is_mirrored) {
    if (levels.brake) return 0;
    return levels.direction != is_mirrored ? levels.duty : static_cast<int16_t>(-levels.duty);
  }
  static double pushed_pwm(const MotorLevels& levels, double duty, bool is_mirrored);
  double load_pwm(double left_pwm, double right_pwm) const;
  void move(double left_m, double right_m);

  WorldParameters parameters_;
  DriveTrain left_{1};  // the streams of their random numbers
  DriveTrain right_{2};
  Caster caster_;
  MotorLevels left_levels_ = {false, false, 0};
  MotorLevels right_levels_ = {false, false, 0};
  double left_duty_ = 0.0;  // the output of the pin
  double right_duty_ = 0.0;
  TruePose pose_;
  double rolled_m_ = 0.0;
  uint32_t at_us_ = 0;
  bool has_begun_ = false;
};

}  // namespace hostlink
