// Two encoders with two channels each to nav_msgs/Odometry on "odom" and to /tf, as often as the line carries both:
// eleven times a second at 115200 baud, 24 times at 250000. On the host: --serial PORT@115200
#include <nav_msgs/Odometry.h>
#include <ros.h>
#include <ros/diagnostics.h>
#include <tf/tf.h>
#include <tf/transform_broadcaster.h>

const float kMetresPerEdge = 0.0005f;
const float kWheelSeparationM = 0.2f;
const unsigned long kBaud = 115200;
const unsigned long kBytes = 721 + 101;  // of both frames, with the names below
const unsigned long kPeriodMs = 1 + kBytes * 10 * 1000 / kBaud * 5 / 4;  // ten bits a byte; a fifth of the line is free
const unsigned long kReportMs = 10000;

const uint8_t kLeftA = 2, kLeftB = 4, kRightA = 3, kRightB = 5;

volatile long left_edges = 0;
volatile long right_edges = 0;

#if !defined(IRAM_ATTR)  // of an ESP8266 and an ESP32, whose interrupts must not wait for the flash
#define IRAM_ATTR
#endif

// The other channel tells forwards from backwards.
void IRAM_ATTR count_left() { left_edges = left_edges + (digitalRead(kLeftA) == digitalRead(kLeftB) ? -1 : 1); }
void IRAM_ATTR count_right() { right_edges = right_edges + (digitalRead(kRightA) == digitalRead(kRightB) ? -1 : 1); }

// The two covariances of 36 numbers make it 713 bytes: too large for an Uno.
typedef ros::NodeHandle_<ArduinoHardware, 25, 25, 128, 768, 1024> OdometryNode;
OdometryNode nh;
nav_msgs::Odometry odometry;
ros::Publisher publisher("odom", &odometry);
geometry_msgs::TransformStamped transform;
tf::TransformBroadcaster broadcaster;
ros::Diagnostics<1> diagnostics("odometry", "two encoders");

float x = 0.0f, y = 0.0f, theta = 0.0f;
long last_left = 0, last_right = 0;
unsigned long measured_at = 0;
unsigned long reported_at = 0;
uint32_t dropped = 0;

void measure(float dt_s) {
  noInterrupts();  // both counts from one moment
  const long left = left_edges;
  const long right = right_edges;
  interrupts();
  const float left_m = static_cast<float>(left - last_left) * kMetresPerEdge;
  const float right_m = static_cast<float>(right - last_right) * kMetresPerEdge;
  last_left = left;
  last_right = right;
  const float way = (left_m + right_m) / 2.0f;
  const float turn = (right_m - left_m) / kWheelSeparationM;
  x += way * static_cast<float>(cos(theta + turn / 2.0f));
  y += way * static_cast<float>(sin(theta + turn / 2.0f));
  theta += turn;
  odometry.twist.twist.linear.x = way / dt_s;
  odometry.twist.twist.angular.z = turn / dt_s;
}

void publish() {
  odometry.header.stamp = nh.now();
  odometry.header.frame_id = "odom";
  odometry.child_frame_id = "base_link";
  odometry.pose.pose.position.x = x;
  odometry.pose.pose.position.y = y;
  odometry.pose.pose.orientation = tf::createQuaternionFromYaw(theta);
  publisher.publish(&odometry);
  transform.header = odometry.header;
  transform.child_frame_id = odometry.child_frame_id;
  transform.transform.translation.x = x;
  transform.transform.translation.y = y;
  transform.transform.rotation = odometry.pose.pose.orientation;
  broadcaster.sendTransform(transform);
}

// Messages that did not fit the line: another baud rate, or more topics.
void report() {
  if (nh.dropped_to_host() == dropped) {
    diagnostics.ok();
  } else {
    diagnostics.warn("messages dropped");
  }
  dropped = nh.dropped_to_host();
  diagnostics.add("dropped", static_cast<int32_t>(dropped));
  diagnostics.publish(nh);
}

void setup() {
  pinMode(kLeftA, INPUT_PULLUP);
  pinMode(kLeftB, INPUT_PULLUP);
  pinMode(kRightA, INPUT_PULLUP);
  pinMode(kRightB, INPUT_PULLUP);
  attachInterrupt(digitalPinToInterrupt(kLeftA), count_left, CHANGE);
  attachInterrupt(digitalPinToInterrupt(kRightA), count_right, CHANGE);
  nh.getHardware()->setBaud(kBaud);
  nh.initNode();
  nh.advertise(publisher);
  broadcaster.init(nh);
  diagnostics.init(nh);
}

void loop() {
  nh.spinOnce();
  const unsigned long now = millis();
  if (now - measured_at < kPeriodMs) return;
  measure(static_cast<float>(now - measured_at) * 0.001f);
  measured_at = now;
  publish();
  if (now - reported_at < kReportMs) return;
  reported_at = now;
  report();
}
