// Every generated header on every compiler: all_types.h is made by tests/firmware/test_board_library.py.
#include "all_types.h"

#define USE(name)                                                         \
  bool read(name& message, ros::Reader& in);                              \
  bool read(name& message, ros::Reader& in) {                             \
    static_assert(name::getSize().has(name::getSize().minimum()), #name); \
    return message.deserialize(in);                                       \
  }                                                                       \
  bool write(const name& message, ros::Writer& out);                      \
  bool write(const name& message, ros::Writer& out) { return message.serialize(out); }
ALL_TYPES(USE)
