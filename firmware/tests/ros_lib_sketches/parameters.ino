// Parameters with defaults of the sketch.
#include <ros.h>
#include <std_msgs/Float32.h>

ros::NodeHandle nh;
std_msgs::Float32 gain;
ros::Publisher p("gain", &gain);
float constants[3];

void setup() {
  nh.initNode();
  nh.advertise(p);
  while (!nh.connected()) nh.spinOnce();
  if (!nh.getParam("/pid", constants, 3)) {
    constants[0] = 1;
    constants[1] = 1;
    constants[2] = 1;
  }
}

void loop() {
  gain.data = constants[2];
  p.publish(&gain);
  nh.spinOnce();
  delay(10);
}
