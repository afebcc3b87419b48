// The host's time, back to the host.
#include <ros.h>
#include <ros/time.h>
#include <std_msgs/Time.h>

ros::NodeHandle nh;
std_msgs::Time test;
ros::Publisher p("my_time", &test);

void setup() {
  pinMode(13, OUTPUT);
  nh.initNode();
  nh.advertise(p);
}

void loop() {
  test.data = nh.now();
  p.publish(&test);
  nh.spinOnce();
  delay(10);
}
