// Interface through which a node checks a frame by its id: whether it is expected, and whether a newer one replaces it.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace ros {

class Topics {
 public:
  // For frames from the host. A false start often shows by its id or its size, long before its checksum.
  virtual bool is_expected(uint16_t id, size_t payload_bytes) const = 0;
  // For frames to the host: whether it is a message of a topic.
  virtual bool is_replaceable(uint16_t id) const = 0;

 protected:
  ~Topics() {}
};

}  // namespace ros
