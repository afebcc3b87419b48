// Stand-in for the Ethernet library.
#pragma once

#include "WiFi.h"

typedef WiFiClient EthernetClient;

class EthernetClass {
 public:
  int begin(uint8_t*) { return 1; }
  void begin(uint8_t*, IPAddress) {}
};

extern EthernetClass Ethernet;
