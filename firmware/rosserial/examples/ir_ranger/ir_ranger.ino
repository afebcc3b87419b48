// A Sharp GP2Y0A21 on A0, whose voltage falls with the distance, to sensor_msgs/Range on "range", twenty times a
// second.
#include <ros.h>
#include <sensor_msgs/Range.h>

const uint8_t kPin = A0;
const float kVoltsPerCount = 5.0f / 1023.0f;
const float kVoltMetres = 0.25f;  // distance times voltage, from its data sheet between 0.1 and 0.8 m
const unsigned long kPeriodMs = 50;

ros::NodeHandle nh;
sensor_msgs::Range range;
ros::Publisher publisher("range", &range);
unsigned long measured_at = 0;

void setup() {
  nh.initNode();
  nh.advertise(publisher);
  range.header.frame_id = "ir_ranger";
  range.radiation_type = sensor_msgs::Range::INFRARED;
  range.field_of_view = 0.05f;
  range.min_range = 0.1f;
  range.max_range = 0.8f;
}

void loop() {
  nh.spinOnce();
  if (millis() - measured_at < kPeriodMs) return;
  measured_at = millis();
  const float metres = kVoltMetres / (static_cast<float>(analogRead(kPin)) * kVoltsPerCount + 0.001f);
  range.range = metres > range.max_range ? INFINITY : metres;  // no object in range
  range.header.stamp = nh.now();
  publisher.publish(&range);
}
