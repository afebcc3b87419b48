// "chatter" over WiFi, from an ESP8266 or an ESP32: the board joins and reconnects by itself. With a key, the same
// as in the host's tcp.key_file, host and board prove it to each other at each connection.
#include <hostlink/keyed.h>
#include <hostlink/wifi.h>
#include <ros.h>
#include <std_msgs/String.h>

const char kWifiName[] = "workshop";
const char kWifiPassword[] = "secret";
const char kHost[] = "192.168.0.10";
const char kKey[] = "";  // empty: no key

#if defined(ESP32)
uint32_t random_bits() { return esp_random(); }
#elif defined(ESP8266)
uint32_t random_bits() { return RANDOM_REG32; }
#else
uint32_t random_bits() { return static_cast<uint32_t>(micros()); }
#endif

ros::NodeHandle_<hostlink::Keyed<hostlink::WifiHardware>> nh;
hostlink::WifiStation wifi;
std_msgs::String text;
ros::Publisher chatter("chatter", &text);
unsigned long published_at = 0;

void setup() {
  wifi.begin(kWifiName, kWifiPassword, "chatter");
  nh.getHardware()->setConnection(kHost);
  nh.getHardware()->setKey(kKey, &random_bits);
  nh.initNode();
  nh.attach(wifi);
  nh.advertise(chatter);
}

void loop() {
  nh.spinOnce();
  if (millis() - published_at < 1000) return;
  published_at = millis();
  text.data = "hello over the air";
  chatter.publish(&text);
}
