// A publisher over WiFi.
#define ROSSERIAL_ARDUINO_TCP
#include <ESP8266WiFi.h>
#include <ros.h>
#include <std_msgs/String.h>

const char* ssid = "workshop";
const char* password = "secret";
IPAddress server(192, 168, 0, 10);
const uint16_t serverPort = 11411;

ros::NodeHandle nh;
std_msgs::String str_msg;
ros::Publisher chatter("chatter", &str_msg);
uint16_t period = 50;
uint32_t last_time = 0;
char hello[13] = "hello world!";

void setup() {
  WiFi.begin(ssid, password);
  while (WiFi.status() != WL_CONNECTED) delay(50);
  nh.getHardware()->setConnection(server, serverPort);
  nh.initNode();
  nh.advertise(chatter);
}

void loop() {
  if (millis() - last_time >= period) {
    last_time = millis();
    if (nh.connected()) {
      str_msg.data = hello;
      chatter.publish(&str_msg);
    }
  }
  nh.spinOnce();
  delay(1);
}
