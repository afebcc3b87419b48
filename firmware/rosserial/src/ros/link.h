// What the node needs of a board: the bytes of the host, and a clock.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace ros {

class Link {
 public:
  static const int kNothing = -1;    // of read(): no byte has come
  static const int kRestarted = -2;  // of read(): what comes now is from another connection, or the connection is gone

  virtual int read() = 0;                                       // the next byte, or one of these; never waits
  virtual size_t write(const uint8_t* bytes, size_t size) = 0;  // accepts what fits now, never waits
  virtual uint32_t milliseconds() = 0;                          // wraps: only differences mean anything

 protected:
  ~Link() {}
};

// Of `given` bytes, what a write() accepted: some say -1 for an error.
inline size_t accepted_of(size_t given, size_t said) { return said <= given ? said : 0; }

}  // namespace ros
