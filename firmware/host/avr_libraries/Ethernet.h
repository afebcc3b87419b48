// Stand-in for the Ethernet library, on the genuine core's own Client: to compile, not to link.
#pragma once

#include <Client.h>
#include <IPAddress.h>

class EthernetClient : public Client {
 public:
  int connect(IPAddress host, uint16_t port) override;
  int connect(const char* host, uint16_t port) override;
  size_t write(uint8_t byte) override;
  size_t write(const uint8_t* bytes, size_t size) override;
  int availableForWrite() override;
  int available() override;
  int read() override;
  int read(uint8_t* bytes, size_t size) override;
  int peek() override;
  void flush() override;
  void stop() override;
  uint8_t connected() override;
  operator bool() override;
};

class EthernetClass {
 public:
  int begin(uint8_t* mac, unsigned long timeout_ms = 60000, unsigned long response_ms = 4000);
  void begin(uint8_t* mac, IPAddress own);
};

extern EthernetClass Ethernet;
