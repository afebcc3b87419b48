// Stand-in for a core's IPAddress.
#pragma once

#include <stdint.h>

class IPAddress {
 public:
  IPAddress() {}
  IPAddress(uint8_t a, uint8_t b, uint8_t c, uint8_t d) : bytes_{a, b, c, d} {}
  uint8_t operator[](int at) const { return bytes_[at]; }
  bool operator==(const IPAddress& other) const { return __builtin_memcmp(bytes_, other.bytes_, 4) == 0; }
  bool operator!=(const IPAddress& other) const { return !(*this == other); }

 private:
  uint8_t bytes_[4] = {};
};
