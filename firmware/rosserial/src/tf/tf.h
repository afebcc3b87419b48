// Rotations about the vertical axis, like in ros_lib.
#pragma once

#include <geometry_msgs/Quaternion.h>
#include <math.h>

namespace tf {

inline geometry_msgs::Quaternion createQuaternionFromYaw(double yaw) {
  geometry_msgs::Quaternion turn;
  turn.x = 0;
  turn.y = 0;
  turn.z = sin(yaw * 0.5);
  turn.w = cos(yaw * 0.5);
  return turn;
}

}  // namespace tf
