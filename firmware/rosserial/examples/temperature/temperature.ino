// A TMP102 on I2C to sensor_msgs/Temperature on "temperature", each second.
#include <Wire.h>
#include <ros.h>
#include <sensor_msgs/Temperature.h>

const uint8_t kAddress = 0x48;
const double kDegreesC = 0.0625;  // degrees of one count; 12 bits, the first ones of two bytes
const unsigned long kPeriodMs = 1000;

ros::NodeHandle nh;
sensor_msgs::Temperature temperature;
ros::Publisher publisher("temperature", &temperature);
unsigned long measured_at = 0;

bool measure() {
  Wire.beginTransmission(kAddress);
  Wire.write(static_cast<uint8_t>(0));
  Wire.endTransmission(false);
  if (Wire.requestFrom(kAddress, static_cast<uint8_t>(2)) != 2) return false;
  const int high = Wire.read();
  const int16_t counts = static_cast<int16_t>(static_cast<int16_t>(high << 8 | Wire.read()) / 16);
  temperature.temperature = counts * kDegreesC;
  return true;
}

void setup() {
  Wire.begin();
  nh.initNode();
  nh.advertise(publisher);
  temperature.header.frame_id = "board";
}

void loop() {
  nh.spinOnce();
  if (millis() - measured_at < kPeriodMs) return;
  measured_at = millis();
  if (!measure()) return;
  temperature.header.stamp = nh.now();
  publisher.publish(&temperature);
}
