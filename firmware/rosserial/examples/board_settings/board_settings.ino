// "chatter" over WiFi, from an ESP8266 or an ESP32 that is flashed once: network, host, name and key are in its flash.
// `hostlink board setup /dev/ttyUSB0` sets them over its serial port, `hostlink board info /dev/ttyUSB0` shows them.
// With a password for updates, the next sketch arrives over the air.
#include <ArduinoOTA.h>
#include <EEPROM.h>
#include <hostlink/keyed.h>
#include <hostlink/settings_eeprom.h>
#include <hostlink/settings_line.h>
#include <hostlink/updates.h>
#include <hostlink/wifi.h>
#include <ros.h>
#include <std_msgs/String.h>

#if defined(ESP32)
uint32_t random_bits() { return esp_random(); }
#elif defined(ESP8266)
uint32_t random_bits() { return RANDOM_REG32; }
#else
uint32_t random_bits() { return static_cast<uint32_t>(micros()); }
#endif

hostlink::EepromStorage<EEPROMClass> storage(EEPROM);
hostlink::BoardSettings settings(storage);
hostlink::SettingsLine settings_line(settings);
hostlink::WifiStation wifi;
ros::NodeHandle_<hostlink::Keyed<hostlink::WifiHardware>> nh;
std_msgs::String text;
ros::Publisher chatter("chatter", &text);
hostlink::Updates<ArduinoOTAClass> updates(ArduinoOTA);  // for a robot: updates(ArduinoOTA, watchdog)
unsigned long published_at = 0;

void setup() {
  Serial.begin(115200);
  settings.load();
  wifi.begin(settings.wifi_name(), settings.wifi_password(), settings.name()[0] == '\0' ? nullptr : settings.name());
  nh.getHardware()->setConnection(settings.host(), settings.port());
  nh.getHardware()->setKey(settings.key(), &random_bits);
  nh.setNamespace(settings.name_space());
  nh.initNode();
  nh.attach(wifi);
  nh.advertise(chatter);
  updates.begin(settings.name(), settings.update_password());
}

void loop() {
  if (settings_line.spin(Serial)) ESP.restart();  // new settings are stored
  updates.spin();
  nh.spinOnce();
  if (millis() - published_at < 1000) return;
  published_at = millis();
  text.data = "hello from a board that knows its host";
  chatter.publish(&text);
}
