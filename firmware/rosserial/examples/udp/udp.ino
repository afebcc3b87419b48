// "chatter" in datagrams over WiFi: [udp] in the host's configuration. Lost datagrams are not sent again: use UDP for
// sensors, not for commands.
#include <WiFiUdp.h>
#include <hostlink/udp_hardware.h>
#include <hostlink/wifi.h>
#include <ros.h>
#include <std_msgs/String.h>

const char kWifiName[] = "workshop";
const char kWifiPassword[] = "secret";

ros::NodeHandle_<hostlink::UdpHardware<WiFiUDP>> nh;
hostlink::WifiStation wifi;
std_msgs::String text;
ros::Publisher chatter("chatter", &text);
unsigned long published_at = 0;

void setup() {
  wifi.begin(kWifiName, kWifiPassword, "chatter");
  nh.getHardware()->setNetwork(&hostlink::WifiStation::is_joined);
  nh.getHardware()->setConnection(IPAddress(192, 168, 0, 10));
  nh.initNode();
  nh.attach(wifi);
  nh.advertise(chatter);
}

void loop() {
  nh.spinOnce();
  if (millis() - published_at < 1000) return;
  published_at = millis();
  text.data = "hello in a datagram";
  chatter.publish(&text);
}
