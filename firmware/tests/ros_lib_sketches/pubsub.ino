// A publisher and a subscriber.
#include <ros.h>
#include <std_msgs/Empty.h>
#include <std_msgs/String.h>

ros::NodeHandle nh;

void messageCb(const std_msgs::Empty&) { digitalWrite(13, HIGH - digitalRead(13)); }

ros::Subscriber<std_msgs::Empty> sub("toggle_led", messageCb);
std_msgs::String str_msg;
ros::Publisher chatter("chatter", &str_msg);
char hello[] = "hello world!";

void setup() {
  pinMode(13, OUTPUT);
  nh.getHardware()->setBaud(115200);
  nh.initNode();
  nh.advertise(chatter);
  nh.subscribe(sub);
}

void loop() {
  str_msg.data = hello;
  chatter.publish(&str_msg);
  nh.spinOnce();
  delay(50);
}
