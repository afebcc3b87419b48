// A topic from the host.
#pragma once

#include "callable.h"
#include "node.h"

namespace ros {

#if defined(__AVR__)
const size_t kStorageBytes = 64;
#else
const size_t kStorageBytes = 256;
#endif

// Memory for one message while its callback runs: the elements of its variable arrays.
template <size_t kBytes>
struct Storage {
  union {
    uint64_t alignment;
    uint8_t bytes[kBytes];
  };
  uint8_t* start() { return bytes; }
};

template <>
struct Storage<0> {
  uint8_t* start() { return nullptr; }
};

// The message, its texts and its arrays are invalid after the callback. `kArrayBytes`: for the elements of its variable
// arrays, except uint8[]; a larger message is refused.
template <class M, class T = void, size_t kArrayBytes = kStorageBytes>
class Subscriber : public Receiver {
 public:
  // A function, or a lambda that captures at most three references.
  template <class F>
  Subscriber(const char* topic, F callback) : Subscriber(topic, Callable<void(M&)>(callback)) {}
  // A function, like in ros_lib.
  Subscriber(const char* topic, void (*callback)(const M&)) : Subscriber(topic, Callable<void(M&)>(callback)) {}
  // A member function of an object.
  template <class C, class Object>
  Subscriber(const char* topic, void (C::*member)(const M&), Object* object)
      : Subscriber(topic, Callable<void(M&)>(MemberOf<C, void (C::*)(const M&)>{member, object})) {}
  template <class C, class Object>
  Subscriber(const char* topic, void (C::*member)(const M&) const, Object* object)
      : Subscriber(topic, Callable<void(M&)>(MemberOf<const C, void (C::*)(const M&) const>{member, object})) {}

 private:
  Subscriber(const char* topic, const Callable<void(M&)>& callback)
      : Receiver(Kind::kSubscriber, topic, M::getType(), M::getMD5(), M::getSize(), &Subscriber::receive),
        callback_(callback) {}

  static bool receive(Receiver& self, uint8_t* payload, size_t size) {
    Storage<M::getSize().is_fixed() ? 0 : kArrayBytes> storage;
    Reader in(payload, size, storage.start(), M::getSize().is_fixed() ? 0 : kArrayBytes);
    M message;
    if (!message.deserialize(in) || in.left() > 0) return false;
    static_cast<Subscriber&>(self).callback_(message);
    return true;
  }

  Callable<void(M&)> callback_;
};

}  // namespace ros
