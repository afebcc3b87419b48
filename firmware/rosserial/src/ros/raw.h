// Topics whose payloads the sketch reads and writes itself.
#pragma once

#include "node.h"

namespace ros {

class RawPublisher : public Sender {
 public:
  RawPublisher(const char* topic, FlashText type, FlashText md5) : Sender(Kind::kPublisher, topic, type, md5) {}

  // Returns what Publisher::publish returns.
  int publish(const uint8_t* payload, size_t size);
};

class RawSubscriber : public Receiver {
 public:
  typedef void (*Callback)(void* context, const uint8_t* payload, size_t size);

  RawSubscriber(const char* topic, FlashText type, FlashText md5, Size size, Callback callback, void* context)
      : Receiver(Kind::kSubscriber, topic, type, md5, size, &RawSubscriber::receive),
        callback_(callback),
        context_(context) {}

 private:
  static bool receive(Receiver& self, uint8_t* payload, size_t size);

  Callback callback_;
  void* context_;
};

}  // namespace ros
