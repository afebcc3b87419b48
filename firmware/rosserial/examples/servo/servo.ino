// A servo on pin 9 turns to the angle of "servo", in degrees.
#include <Servo.h>
#include <ros.h>
#include <std_msgs/UInt16.h>

ros::NodeHandle nh;
Servo servo;

void turn(const std_msgs::UInt16& angle_deg) { servo.write(angle_deg.data < 180 ? angle_deg.data : 180); }

ros::Subscriber<std_msgs::UInt16> subscriber("servo", &turn);

void setup() {
  servo.attach(9);
  nh.initNode();
  nh.subscribe(subscriber);
}

void loop() { nh.spinOnce(); }
