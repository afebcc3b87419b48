// An MPU-6050 on I2C to sensor_msgs/Imu on "imu/data_raw", with diagnostics, as often as the line carries it: 28 times a
// second at 115200 baud, 62 times at 250000. On the host: --serial PORT@115200
#include <Wire.h>
#include <ros.h>
#include <ros/diagnostics.h>
#include <sensor_msgs/Imu.h>

const uint8_t kAddress = 0x68, kPower = 0x6B, kFirst = 0x3B;
const float kMetresS2 = 9.80665f / 16384.0f;            // m/s2 of one count at +-2 g
const float kRadiansS = 3.14159265f / 180.0f / 131.0f;  // +-250 degrees/s
const unsigned long kBaud = 115200;
const unsigned long kBytes = 323;  // of a frame, with the name below
const unsigned long kPeriodMs = 1 + kBytes * 10 * 1000 / kBaud * 5 / 4;  // ten bits a byte; a fifth of the line is free

ros::NodeHandle_<ArduinoHardware, 25, 25, 64, 352, 512> nh;
sensor_msgs::Imu imu;
ros::Publisher publisher("imu/data_raw", &imu);
ros::Diagnostics<2> diagnostics("imu", "MPU-6050");
unsigned long measured_at = 0;
int32_t measured = 0;
uint32_t dropped = 0;  // messages that did not fit the line: another baud rate, or more topics

float read_number() {
  const int high = Wire.read();
  return static_cast<float>(static_cast<int16_t>(high << 8 | Wire.read()));
}

bool measure() {
  Wire.beginTransmission(kAddress);
  Wire.write(kFirst);
  Wire.endTransmission(false);
  if (Wire.requestFrom(kAddress, static_cast<uint8_t>(14)) != 14) return false;
  imu.linear_acceleration.x = read_number() * kMetresS2;
  imu.linear_acceleration.y = read_number() * kMetresS2;
  imu.linear_acceleration.z = read_number() * kMetresS2;
  read_number();  // the temperature
  imu.angular_velocity.x = read_number() * kRadiansS;
  imu.angular_velocity.y = read_number() * kRadiansS;
  imu.angular_velocity.z = read_number() * kRadiansS;
  return true;
}

void setup() {
  Wire.begin();
  Wire.beginTransmission(kAddress);
  Wire.write(kPower);
  Wire.write(static_cast<uint8_t>(0));  // wake the sensor
  Wire.endTransmission();
  nh.getHardware()->setBaud(kBaud);
  nh.initNode();
  nh.advertise(publisher);
  diagnostics.init(nh);
  imu.header.frame_id = "imu";
  imu.orientation_covariance[0] = -1;  // not measured
}

void loop() {
  nh.spinOnce();
  if (millis() - measured_at < kPeriodMs) return;
  measured_at = millis();
  const bool is_good = measure();
  if (is_good) {
    imu.header.stamp = nh.now();
    publisher.publish(&imu);
  }
  if (++measured % 50 != 0) return;
  if (!is_good) {
    diagnostics.error("no answer");
  } else if (nh.dropped_to_host() != dropped) {
    diagnostics.warn("messages dropped");
  } else {
    diagnostics.ok();
  }
  dropped = nh.dropped_to_host();
  diagnostics.add("measurements", measured);
  diagnostics.add("dropped", static_cast<int32_t>(dropped));
  diagnostics.publish(nh);
}
