// Parameters with defaults: requested at each request for topics, without waiting. The host's configuration sets them
// in
#include <ros.h>
#include <ros/parameter.h>
#include <std_msgs/String.h>

ros::NodeHandle nh;
ros::Parameters parameters;
ros::Parameter<int> blink_ms("/blink_ms", 500, 20, 10000);  // a value out of range is refused
ros::TextParameter<32> text("/text", "hello");
std_msgs::String message;
ros::Publisher chatter("chatter", &message);
unsigned long blinked_at = 0;

void setup() {
  pinMode(LED_BUILTIN, OUTPUT);
  parameters.add(blink_ms);
  parameters.add(text);
  nh.initNode();
  nh.attach(parameters);
  nh.advertise(chatter);
}

void loop() {
  nh.spinOnce();
  if (millis() - blinked_at < static_cast<unsigned long>(blink_ms.value())) return;
  blinked_at = millis();
  digitalWrite(LED_BUILTIN, digitalRead(LED_BUILTIN) == HIGH ? LOW : HIGH);
  message.data = text.text();
  chatter.publish(&message);
}
