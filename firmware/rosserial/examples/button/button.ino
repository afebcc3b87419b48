// A button on pin 7 to std_msgs/Bool on "pushed", when it changes; the analog inputs on "adc", ten times a second.
#include <ros.h>
#include <std_msgs/Bool.h>
#include <std_msgs/UInt16MultiArray.h>

const uint8_t kButton = 7;
const uint8_t kInputs[] = {A0, A1, A2, A3};
const unsigned long kDebounceMs = 50;

ros::NodeHandle nh;
std_msgs::Bool pushed;
ros::Publisher button("pushed", &pushed);
uint16_t values[sizeof kInputs];
std_msgs::UInt16MultiArray adc;
ros::Publisher inputs("adc", &adc);
bool was_pushed = false;
unsigned long changed_at = 0;
unsigned long published_at = 0;

void setup() {
  pinMode(kButton, INPUT_PULLUP);
  nh.initNode();
  nh.advertise(button);
  nh.advertise(inputs);
  adc.data = values;
  adc.data_length = sizeof kInputs;
}

void loop() {
  nh.spinOnce();
  const unsigned long now = millis();
  const bool is_pushed = digitalRead(kButton) == LOW;
  if (is_pushed != was_pushed && now - changed_at > kDebounceMs) {
    was_pushed = is_pushed;
    changed_at = now;
    pushed.data = is_pushed;
    button.publish(&pushed);
  }
  if (now - published_at < 100) return;
  published_at = now;
  for (size_t i = 0; i < sizeof kInputs; ++i) values[i] = static_cast<uint16_t>(analogRead(kInputs[i]));
  inputs.publish(&adc);
}
