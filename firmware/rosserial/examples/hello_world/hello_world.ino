// The first sketch: "hello world!" on "chatter" each second. hostlink echo /chatter
#include <ros.h>
#include <std_msgs/String.h>

ros::NodeHandle nh;
std_msgs::String text;
ros::Publisher chatter("chatter", &text);
unsigned long published_at = 0;

void setup() {
  nh.initNode();
  nh.advertise(chatter);
  text.data = "hello world!";
}

void loop() {
  nh.spinOnce();
  if (millis() - published_at < 1000) return;
  published_at = millis();
  chatter.publish(&text);
}
