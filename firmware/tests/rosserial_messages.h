// Messages for the tests of the node alone, by the same contract as the generated headers.
#pragma once

#include <ros/msg.h>

namespace test_msgs {

class Number : public ros::Msg {
 public:
  int32_t data = 0;

  static ros::FlashText getType() {
    static const char text[] ROS_IN_FLASH = "test_msgs/Number";
    return ros::FlashText(text);
  }
  static ros::FlashText getMD5() {
    static const char text[] ROS_IN_FLASH = "da5909fbe378aeaf85e547e830cc1bb7";
    return ros::FlashText(text);
  }
  static constexpr ros::Size getSize() { return ros::Size::exactly(4); }
  bool serialize(ros::Writer& out) const {
    out.put(data);
    return out.is_good();
  }
  bool deserialize(ros::Reader& in) {
    in.get(data);
    return in.is_good();
  }
};

class Words : public ros::Msg {
 public:
  const char* text = "";
  uint32_t values_length = 0;
  float* values = nullptr;

  static ros::FlashText getType() {
    static const char text[] ROS_IN_FLASH = "test_msgs/Words";
    return ros::FlashText(text);
  }
  static ros::FlashText getMD5() {
    static const char text[] ROS_IN_FLASH = "992ce8a1687cec8c8bd883ec73ca41d1";
    return ros::FlashText(text);
  }
  static constexpr ros::Size getSize() { return ros::Size(8, 65535); }
  bool serialize(ros::Writer& out) const {
    out.put(text);
    out.put_variable(values, values_length);
    return out.is_good();
  }
  bool deserialize(ros::Reader& in) {
    in.get(text);
    in.get_variable(values, values_length, 4);
    return in.is_good();
  }
};

}  // namespace test_msgs
