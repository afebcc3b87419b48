// Stand-in for the WiFi of an ESP8266 or ESP32: joined a tenth of a second after begin().
#pragma once

#include "Arduino.h"
#include "IPAddress.h"
#include "tcp_socket.h"

enum WiFiMode_t { WIFI_OFF = 0, WIFI_STA = 1 };
enum WiFiSleepType_t { WIFI_NONE_SLEEP = 0 };
enum wl_status_t { WL_IDLE_STATUS = 0, WL_CONNECTED = 3, WL_DISCONNECTED = 7 };

class WiFiClass {
 public:
  void persistent(bool) {}
  bool mode(WiFiMode_t) { return true; }
  bool setSleepMode(WiFiSleepType_t) { return true; }
  bool setAutoReconnect(bool) { return true; }
  bool hostname(const char*) { return true; }
  wl_status_t begin(const char* name, const char* password);
  bool reconnect() { return true; }
  wl_status_t status() const;

 private:
  unsigned long began_at_ms_ = 0;
  bool has_begun_ = false;
};

extern WiFiClass WiFi;

// Connects to the host of the process's arguments, and ignores its own.
class WiFiClient : public Stream {
 public:
  void setTimeout(unsigned long) {}
  int connect(const char* host, uint16_t port);
  int connect(IPAddress host, uint16_t port);
  uint8_t connected() { return socket_.available() > 0 || socket_.is_open(); }
  int available() override { return socket_.available(); }
  int read() override { return socket_.read(); }
  int availableForWrite() override { return socket_.room(); }
  size_t write(uint8_t byte) override { return socket_.write(&byte, 1); }
  size_t write(const uint8_t* bytes, size_t size) override { return socket_.write(bytes, size); }
  void setNoDelay(bool) {}
  void stop() { socket_.close(); }

 private:
  TcpSocket socket_;
};
