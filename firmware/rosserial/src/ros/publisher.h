// A topic to the host.
#pragma once

#include "node.h"

namespace ros {

// Function that writes a message of type M; one function for each type.
template <class M>
bool serialize_message(const void* message, Writer& out) {
  return static_cast<const M*>(message)->serialize(out);
}

class Publisher : public Sender {
 public:
  // The message is only used for its type.
  template <class M>
  Publisher(const char* topic, const M*) : Sender(Kind::kPublisher, topic, M::getType(), M::getMD5()) {}

  // Returns the bytes of the message; 0: the host has not asked for topics; -1: it is too large, the line is full, or
  // the topic has another type.
  template <class M>
  int publish(const M* message) {
    if (node() == nullptr) return 0;
    if (type().address() != M::getType().address()) return -1;
    return node()->publish(*this, message, &serialize_message<M>);
  }
};

}  // namespace ros
