// Stand-in for the WiFiUDP of an ESP8266 or ESP32: datagrams to the host of the process's arguments.
#pragma once

#include "WiFi.h"

class WiFiUDP {
 public:
  uint8_t begin(uint16_t port);
  int beginPacket(IPAddress host, uint16_t port);
  size_t write(const uint8_t* bytes, size_t size);
  int endPacket();
  int parsePacket();
  int available() { return count_ - at_; }
  int read() { return available() > 0 ? in_[at_++] : -1; }
  int read(uint8_t* bytes, size_t size) {
    size_t count = 0;
    for (; count < size && available() > 0; ++count) bytes[count] = in_[at_++];
    return static_cast<int>(count);
  }
  IPAddress remoteIP() { return from_; }
  uint16_t remotePort() { return port_; }

 private:
  int descriptor_ = -1;
  uint8_t in_[2048];
  int at_ = 0;
  int count_ = 0;
  uint8_t out_[2048];
  size_t out_size_ = 0;
  IPAddress to_;
  IPAddress from_;
  uint16_t port_ = 0;
};
