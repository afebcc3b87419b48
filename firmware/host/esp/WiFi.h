// Stand-in for WiFi.h of an ESP32; of an ESP8266 it is ESP8266WiFi.h.
#pragma once

#include "../any_board/IPAddress.h"
#include "Arduino.h"

enum wl_status_t { WL_IDLE_STATUS = 0, WL_CONNECTED = 3, WL_DISCONNECTED = 6 };
#if defined(ESP32)
enum wifi_mode_t { WIFI_MODE_NULL = 0, WIFI_MODE_STA };
#define WIFI_STA WIFI_MODE_STA
typedef wifi_mode_t WiFiMode_t;
#else
enum WiFiMode_t { WIFI_OFF = 0, WIFI_STA = 1 };
enum WiFiSleepType_t { WIFI_NONE_SLEEP = 0, WIFI_MODEM_SLEEP = 2 };
#endif

class WiFiClass {
 public:
  void persistent(bool is_persistent);
  bool mode(WiFiMode_t mode);
  bool setAutoReconnect(bool is_wanted);
  wl_status_t begin(const char* name, const char* password = nullptr);
  bool reconnect();
  wl_status_t status();
#if defined(ESP32)
  bool setSleep(bool is_wanted);
  bool setHostname(const char* name);
#else
  bool setSleepMode(WiFiSleepType_t type);
  bool hostname(const char* name);
#endif
};

extern WiFiClass WiFi;

class WiFiClient : public Stream {
 public:
  int connect(const char* host, uint16_t port);
  int connect(IPAddress host, uint16_t port);
  uint8_t connected();
  int available() override;
  int read() override;
  size_t write(uint8_t byte) override;
  size_t write(const uint8_t* bytes, size_t size) override;
  void stop();
  void setTimeout(unsigned long ms);
#if defined(ESP32)
  int fd() const;
  int setNoDelay(bool is_wanted);
#else
  int availableForWrite() override;
  void setNoDelay(bool is_wanted);
#endif
};
