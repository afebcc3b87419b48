// "chatter" over an Ethernet shield: the board reconnects by itself.
#include <Ethernet.h>
#include <hostlink/ethernet.h>
#include <ros.h>
#include <std_msgs/String.h>

uint8_t mac[] = {0xDE, 0xAD, 0xBE, 0xEF, 0xFE, 0xED};
const IPAddress kOwnAddress(192, 168, 0, 177);
const IPAddress kHost(192, 168, 0, 10);

ros::NodeHandle_<hostlink::EthernetHardware, 25, 25, 280, 280> nh;
std_msgs::String text;
ros::Publisher chatter("chatter", &text);
unsigned long published_at = 0;

void setup() {
  Ethernet.begin(mac, kOwnAddress);
  nh.getHardware()->setConnection(kHost);
  nh.initNode();
  nh.advertise(chatter);
}

void loop() {
  nh.spinOnce();
  if (millis() - published_at < 1000) return;
  published_at = millis();
  text.data = "hello over a cable";
  chatter.publish(&text);
}
