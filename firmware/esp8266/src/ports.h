// What the passthrough needs of a board. No call may block, except Network::connect() within its bound.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace hostlink {

class Uart {
 public:
  virtual size_t read(uint8_t* bytes, size_t limit_bytes) = 0;
  virtual size_t room_bytes() = 0;
  virtual size_t write(const uint8_t* bytes, size_t count) = 0;

 protected:
  ~Uart() = default;
};

class Network {
 public:
  virtual bool is_joined() = 0;
  virtual int signal_dbm() = 0;  // 0 or more: unknown
  virtual void rejoin() = 0;
  virtual bool connect() = 0;
  virtual bool is_connected() = 0;
  virtual size_t read(uint8_t* bytes, size_t limit_bytes) = 0;
  virtual size_t room_bytes() = 0;
  virtual size_t write(const uint8_t* bytes, size_t count) = 0;
  virtual void close() = 0;

 protected:
  ~Network() = default;
};

}  // namespace hostlink
