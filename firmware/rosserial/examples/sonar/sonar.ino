// An HC-SR04 to sensor_msgs/Range on "ultrasound", ten times a second.
#include <ros.h>
#include <sensor_msgs/Range.h>

const uint8_t kTrigger = 7, kEcho = 8;
const float kMetresPerMicrosecond = 343.0f / 2.0f / 1e6f;  // to the object and back
const unsigned long kPeriodMs = 100;
const unsigned long kTimeoutUs = 25000;  // four metres

ros::NodeHandle nh;
sensor_msgs::Range range;
ros::Publisher publisher("ultrasound", &range);
unsigned long measured_at = 0;

void setup() {
  pinMode(kTrigger, OUTPUT);
  pinMode(kEcho, INPUT);
  nh.initNode();
  nh.advertise(publisher);
  range.header.frame_id = "ultrasound";
  range.radiation_type = sensor_msgs::Range::ULTRASOUND;
  range.field_of_view = 0.26f;
  range.min_range = 0.02f;
  range.max_range = 4.0f;
}

void loop() {
  nh.spinOnce();
  if (millis() - measured_at < kPeriodMs) return;
  measured_at = millis();
  digitalWrite(kTrigger, HIGH);
  delayMicroseconds(10);
  digitalWrite(kTrigger, LOW);
  const unsigned long echo_us = pulseIn(kEcho, HIGH, kTimeoutUs);
  range.range = echo_us == 0 ? INFINITY : static_cast<float>(echo_us) * kMetresPerMicrosecond;  // 0: no object in range
  range.header.stamp = nh.now();
  publisher.publish(&range);
}
