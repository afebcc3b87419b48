// The kinematics of a differential drive, and odometry by tick counts (docs/paper-robot.md#equations). Metres,
// radians, seconds.
#pragma once

#include "constants.h"

namespace hostlink {

struct Pose {
  double x_m;  // the only doubles in the firmware: a sum of many small steps
  double y_m;
  double theta_rad;  // in (-pi, pi]
};

// Properties of one wheel; no two wheels are equal.
struct WheelSize {
  float radius_m;
  float ticks_per_turn;  // periods of its encoder
};

class Drive {
 public:
  void set_wheel_radii(float left_m, float right_m);
  void set_ticks_per_turn(float left, float right);
  void set_separation(float separation_m) { separation_m_ = separation_m; }
  void set_top_speed(float ticks_s) { top_speed_ticks_s_ = ticks_s; }
  const WheelSize& left() const { return left_; }
  const WheelSize& right() const { return right_; }
  float separation_m() const { return separation_m_; }

  // Wheel speeds for this body velocity. Both are scaled down together so that the faster one keeps the limit.
  void wheel_speeds(float linear_m_s, float angular_rad_s, float& left_ticks_s, float& right_ticks_s) const;
  // Pose after the wheels have rolled these distances along the arc of a circle.
  Pose integrate(const Pose& pose, float left_ticks, float right_ticks) const;

 private:
  WheelSize left_ = {kWheelRadiusM, kTicksPerTurn};
  WheelSize right_ = {kWheelRadiusM, kTicksPerTurn};
  float separation_m_ = kWheelSeparationM;
  float top_speed_ticks_s_ = kTopSpeedTicksS;
};

}  // namespace hostlink
