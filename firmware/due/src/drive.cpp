#include "drive.h"

#include <math.h>

namespace hostlink {

namespace {

const double kPi = 3.14159265358979323846;
const double kSmallAngleRad = 1e-6;

double wrap_angle(double angle_rad) {
  const double turned = angle_rad - 2.0 * kPi * floor((angle_rad + kPi) / (2.0 * kPi));  // in [-pi, pi)
  return turned <= -kPi ? kPi : turned;
}

float magnitude(float value) { return value < 0.0f ? -value : value; }

float metres_per_tick(const WheelSize& wheel) {
  return 2.0f * static_cast<float>(kPi) * wheel.radius_m / wheel.ticks_per_turn;
}

}  // namespace

void Drive::set_wheel_radii(float left_m, float right_m) {
  left_.radius_m = left_m;
  right_.radius_m = right_m;
}

void Drive::set_ticks_per_turn(float left, float right) {
  left_.ticks_per_turn = left;
  right_.ticks_per_turn = right;
}

void Drive::wheel_speeds(float linear_m_s, float angular_rad_s, float& left_ticks_s, float& right_ticks_s) const {
  const float turning_m_s = angular_rad_s * separation_m_ / 2.0f;
  const float left = (linear_m_s - turning_m_s) / metres_per_tick(left_);
  const float right = (linear_m_s + turning_m_s) / metres_per_tick(right_);
  const float fastest = magnitude(left) > magnitude(right) ? magnitude(left) : magnitude(right);
  const float factor = fastest > top_speed_ticks_s_ ? top_speed_ticks_s_ / fastest : 1.0f;
  left_ticks_s = left * factor;
  right_ticks_s = right * factor;
}

Pose Drive::integrate(const Pose& pose, float left_ticks, float right_ticks) const {
  const double left_m = static_cast<double>(left_ticks) * static_cast<double>(metres_per_tick(left_));
  const double right_m = static_cast<double>(right_ticks) * static_cast<double>(metres_per_tick(right_));
  const double distance_m = (left_m + right_m) / 2.0;
  const double turned_rad = (right_m - left_m) / static_cast<double>(separation_m_);
  // The chord of the arc; for a straight line it is the line.
  const double half_rad = turned_rad / 2.0;
  const double chord_m = fabs(half_rad) < kSmallAngleRad ? distance_m : distance_m * sin(half_rad) / half_rad;
  const double heading_rad = pose.theta_rad + half_rad;
  Pose moved = {pose.x_m + chord_m * cos(heading_rad), pose.y_m + chord_m * sin(heading_rad),
                wrap_angle(pose.theta_rad + turned_rad)};
  return moved;
}

}  // namespace hostlink
