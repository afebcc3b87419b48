// Stand-in for the core's ESP8266WiFi: a station that joins, and a client on a real socket.
#pragma once

#include <memory>

#include "Arduino.h"

namespace standin {
class Connection;
}

enum WiFiMode_t { WIFI_OFF = 0, WIFI_STA = 1 };
enum WiFiSleepType_t { WIFI_NONE_SLEEP = 0, WIFI_LIGHT_SLEEP = 1, WIFI_MODEM_SLEEP = 2 };
enum wl_status_t { WL_IDLE_STATUS = 0, WL_CONNECTED = 3, WL_DISCONNECTED = 7 };

class ESP8266WiFiClass {
 public:
  void persistent(bool is_persistent);
  bool mode(WiFiMode_t mode);
  bool setSleepMode(WiFiSleepType_t type);
  bool setAutoReconnect(bool is_automatic);
  bool hostname(const char* name);
  wl_status_t begin(const char* ssid, const char* passphrase);
  bool reconnect();
  wl_status_t status();
  int8_t RSSI();
};

class WiFiClient {
 public:
  void setTimeout(unsigned long timeout_ms) { timeout_ms_ = timeout_ms; }
  int connect(const char* host, uint16_t port);
  uint8_t connected();
  int available();
  int read(uint8_t* buffer, size_t size);
  size_t availableForWrite();
  size_t write(const uint8_t* buffer, size_t size);
  void setNoDelay(bool is_wanted);
  void keepAlive(uint16_t idle_s, uint16_t interval_s, uint8_t count);
  bool stop(unsigned int limit_ms = 0);

 private:
  std::shared_ptr<standin::Connection> connection_;
  unsigned long timeout_ms_ = 5000;
};

extern ESP8266WiFiClass WiFi;
