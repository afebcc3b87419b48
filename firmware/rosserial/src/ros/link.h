// Interface of a board for the node: bytes from and to the host, and a clock.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace ros {

class Link {
 public:
  static const int kNothing = -1;    // of read(): no byte has come
  static const int kRestarted = -2;  // result of read(): another connection, or the connection is lost

  virtual int read() = 0;                                       // the next byte, or one of these; never waits
  virtual size_t write(const uint8_t* bytes, size_t size) = 0;  // accepts what fits now, never waits
  virtual uint32_t milliseconds() = 0;                          // wraps: use differences only
  virtual bool drains() { return false; }  // write() soon accepts more of itself: a UART with a ring of a few bytes

 protected:
  ~Link() {}
};

// How many of the `given` bytes a write() accepted: some return -1 for an error.
inline size_t accepted_of(size_t given, size_t said) { return said <= given ? said : 0; }

}  // namespace ros
