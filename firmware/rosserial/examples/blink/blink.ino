// The LED is lit while the last message on "led" was true: hostlink pub /led std_msgs/Bool '{"data": true}'.
#include <ros.h>
#include <std_msgs/Bool.h>

ros::NodeHandle nh;

ros::Subscriber<std_msgs::Bool> led("led", [](const std_msgs::Bool& message) {
  digitalWrite(LED_BUILTIN, message.data ? HIGH : LOW);
});

void setup() {
  pinMode(LED_BUILTIN, OUTPUT);
  nh.initNode();
  nh.subscribe(led);
}

void loop() { nh.spinOnce(); }
