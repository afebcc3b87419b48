// Publishes on "chatter" each second, and toggles the LED for each message on "toggle_led".
#include <ros.h>
#include <std_msgs/Empty.h>
#include <std_msgs/String.h>

ros::NodeHandle nh;

void toggle(const std_msgs::Empty&) { digitalWrite(LED_BUILTIN, digitalRead(LED_BUILTIN) == HIGH ? LOW : HIGH); }

std_msgs::String text;
ros::Publisher chatter("chatter", &text);
ros::Subscriber<std_msgs::Empty> subscriber("toggle_led", &toggle);
unsigned long published_at = 0;

void setup() {
  pinMode(LED_BUILTIN, OUTPUT);
  nh.initNode();
  nh.advertise(chatter);
  nh.subscribe(subscriber);
}

void loop() {
  if (millis() - published_at >= 1000) {
    published_at = millis();
    text.data = "hello world!";
    chatter.publish(&text);
  }
  nh.spinOnce();
}
