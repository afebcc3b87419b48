#include "raw.h"

namespace ros {

namespace {

struct Payload {
  const uint8_t* bytes;
  size_t size;
};

bool put_payload(const void* message, Writer& out) {
  const Payload& payload = *static_cast<const Payload*>(message);
  for (size_t i = 0; i < payload.size; ++i) out.put(payload.bytes[i]);
  return out.is_good();
}

}  // namespace

int RawPublisher::publish(const uint8_t* payload, size_t size) {
  if (node() == nullptr) return 0;
  const Payload message = {payload, size};
  return node()->publish(*this, &message, put_payload);
}

bool RawSubscriber::receive(Receiver& self, uint8_t* payload, size_t size) {
  RawSubscriber& subscriber = static_cast<RawSubscriber&>(self);
  subscriber.callback_(subscriber.context_, payload, size);
  return true;
}

}  // namespace ros
