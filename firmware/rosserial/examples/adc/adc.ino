// Six analog inputs to rosserial_arduino/Adc on "adc", ten times a second.
#include <ros.h>
#include <rosserial_arduino/Adc.h>

const unsigned long kPeriodMs = 100;

ros::NodeHandle nh;
rosserial_arduino::Adc adc;
ros::Publisher publisher("adc", &adc);
unsigned long published_at = 0;

uint16_t read_input(uint8_t number) { return static_cast<uint16_t>(analogRead(number)); }

void setup() {
  nh.initNode();
  nh.advertise(publisher);
}

void loop() {
  nh.spinOnce();
  if (millis() - published_at < kPeriodMs) return;
  published_at = millis();
  adc.adc0 = read_input(0);
  adc.adc1 = read_input(1);
  adc.adc2 = read_input(2);
  adc.adc3 = read_input(3);
  adc.adc4 = read_input(4);
  adc.adc5 = read_input(5);
  publisher.publish(&adc);
}
