// The place of a sensor on the robot, from "base_link" to "camera", on /tf ten times a second.
#include <ros.h>
#include <tf/tf.h>
#include <tf/transform_broadcaster.h>

const float kForwardsM = 0.12f, kUpM = 0.2f;
const double kYaw = 0.0;
const unsigned long kPeriodMs = 100;

ros::NodeHandle nh;
geometry_msgs::TransformStamped transform;
tf::TransformBroadcaster broadcaster;
unsigned long sent_at = 0;

void setup() {
  nh.initNode();
  broadcaster.init(nh);
  transform.header.frame_id = "base_link";
  transform.child_frame_id = "camera";
  transform.transform.translation.x = kForwardsM;
  transform.transform.translation.z = kUpM;
  transform.transform.rotation = tf::createQuaternionFromYaw(kYaw);
}

void loop() {
  nh.spinOnce();
  if (millis() - sent_at < kPeriodMs) return;
  sent_at = millis();
  transform.header.stamp = nh.now();
  broadcaster.sendTransform(transform);
}
