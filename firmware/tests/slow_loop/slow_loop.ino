// A loop that takes two and a half seconds, as with a slow sensor, and messages that are larger than the ring of an
// AVR's UART (63 bytes).
#include <ros.h>
#include <std_msgs/Empty.h>
#include <std_msgs/Int32.h>
#include <std_msgs/String.h>

ros::NodeHandle nh;
std_msgs::String text;
ros::Publisher chatter("chatter", &text);
std_msgs::Int32 count;
ros::Publisher counter("counter", &count);

void toggle(const std_msgs::Empty&) { digitalWrite(LED_BUILTIN, !digitalRead(LED_BUILTIN)); }
ros::Subscriber<std_msgs::Empty> subscriber("toggle_led", &toggle);

void setup() {
  pinMode(LED_BUILTIN, OUTPUT);
  nh.initNode();
  nh.advertise(chatter);
  nh.advertise(counter);
  nh.subscribe(subscriber);
}

void loop() {
  nh.spinOnce();
  text.data = "one hundred characters and more, which take longer than the ring holds: humidity 48.1 %, pressure 1013 hPa";
  chatter.publish(&text);
  ++count.data;
  counter.publish(&count);
  delay(2500);
}
