// The payloads that the robot reads and writes. float64 is 8 bytes on the wire on every board, also where double has 4.
#pragma once

#include <ros/flash_text.h>
#include <stddef.h>
#include <stdint.h>

namespace hostlink {

const size_t kFloat64Bytes = 8;
const size_t kTwistBytes = 6 * kFloat64Bytes;
const size_t kPose2DBytes = 3 * kFloat64Bytes;
const size_t kVector3Bytes = 3 * kFloat64Bytes;

const char kTwistType[] ROS_IN_FLASH = "geometry_msgs/Twist";
const char kTwistMd5[] ROS_IN_FLASH = "9f195f881246fdfa2798d1d3eebca84a";
const char kPose2DType[] ROS_IN_FLASH = "geometry_msgs/Pose2D";
const char kPose2DMd5[] ROS_IN_FLASH = "938fa65709584ad8e77d238529be13b8";
const char kVector3Type[] ROS_IN_FLASH = "geometry_msgs/Vector3";
const char kVector3Md5[] ROS_IN_FLASH = "4a842b65f413084dc2b10fb484ea7f17";
const char kBatteryStateType[] ROS_IN_FLASH = "sensor_msgs/BatteryState";
const char kBatteryStateMd5[] ROS_IN_FLASH = "4ddae7f048e32fda22cac764685e3974";
const size_t kBatteryVoltageAt = 16;  // after the header; six more float32 follow
const size_t kBatteryFloats = 7;
const size_t kBatteryPresentAt = 47;
const size_t kBatteryStateBytes = 64;  // with empty lists and texts
const char kUInt16MultiArrayType[] ROS_IN_FLASH = "std_msgs/UInt16MultiArray";
const char kUInt16MultiArrayMd5[] ROS_IN_FLASH = "52f264f1c973c4b73790d384c6cb4484";
const size_t kUInt16MultiArrayBytes = 12;  // without its data; the last four bytes are the number of elements
const char kEmptyType[] ROS_IN_FLASH = "std_msgs/Empty";
const char kEmptyMd5[] ROS_IN_FLASH = "d41d8cd98f00b204e9800998ecf8427e";

// Round a float64 of the wire towards zero to a float. A value that no float can represent becomes infinite or zero.
float read_float64(const uint8_t* bytes);
void write_float64(uint8_t* bytes, float value);
void write_float32(uint8_t* bytes, float value);

}  // namespace hostlink
