// A TCP connection like the client of a core. Only connect() waits.
#pragma once

#include <stddef.h>
#include <stdint.h>

class TcpSocket {
 public:
  ~TcpSocket() { close(); }
  bool connect(const char* host, uint16_t port);
  void close();
  bool is_open() const { return descriptor_ >= 0; }
  int available();
  int read();
  size_t write(const uint8_t* bytes, size_t size);
  int room();

 private:
  void fill();

  int descriptor_ = -1;
  uint8_t bytes_[4096];
  int at_ = 0;
  int count_ = 0;
};
