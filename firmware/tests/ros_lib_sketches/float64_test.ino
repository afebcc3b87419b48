// A number of eight bytes, there and back.
#include <ros.h>
#include <std_msgs/Float64.h>

ros::NodeHandle nh;
float x;

void messageCb(const std_msgs::Float64& msg) {
  x = msg.data - 1.0;
  digitalWrite(13, HIGH - digitalRead(13));
}

std_msgs::Float64 test;
ros::Subscriber<std_msgs::Float64> s("your_topic", &messageCb);
ros::Publisher p("my_topic", &test);

void setup() {
  pinMode(13, OUTPUT);
  nh.initNode();
  nh.advertise(p);
  nh.subscribe(s);
}

void loop() {
  test.data = x;
  p.publish(&test);
  nh.spinOnce();
  delay(10);
}
