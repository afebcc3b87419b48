// Stand-in for the UDP of both cores.
#pragma once

#include "WiFi.h"

class WiFiUDP : public Stream {
 public:
  uint8_t begin(uint16_t port);
  int beginPacket(IPAddress host, uint16_t port);
  int endPacket();
  size_t write(uint8_t byte) override;
  size_t write(const uint8_t* bytes, size_t size) override;
  int parsePacket();
  int available() override;
  int read() override;
  int read(unsigned char* bytes, size_t size);
  IPAddress remoteIP();
  uint16_t remotePort();
};
