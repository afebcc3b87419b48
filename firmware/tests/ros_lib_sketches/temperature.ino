// A TMP102 on I2C.
#include <Wire.h>
#include <ros.h>
#include <std_msgs/Float32.h>

ros::NodeHandle nh;
std_msgs::Float32 temp_msg;
ros::Publisher pub_temp("temperature", &temp_msg);
int sensorAddress = 0x91 >> 1;
long publisher_timer;

void setup() {
  Wire.begin();
  nh.initNode();
  nh.advertise(pub_temp);
}

void loop() {
  if ((long)millis() > publisher_timer) {
    Wire.requestFrom(sensorAddress, 2);
    if (2 <= Wire.available()) {
      byte msb = Wire.read();
      byte lsb = Wire.read();
      int temperature = ((msb) << 4);
      temperature |= (lsb >> 4);
      temp_msg.data = temperature * 0.0625;
      pub_temp.publish(&temp_msg);
    }
    publisher_timer = millis() + 50;
  }
  nh.spinOnce();
}
