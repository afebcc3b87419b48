// Endpoints that a node announces to its host: a topic, or half of a service. The objects belong to the sketch and stay
// in place; a node links them and has no table of them.
#pragma once

#include "flash_text.h"

namespace ros {

class Node;

// The special ids by which an endpoint is announced (docs/protocol.md#special-ids).
enum class Kind : uint8_t {
  kPublisher = 0,
  kSubscriber = 1,
  kServerResponse = 2,
  kServerRequest = 3,
  kClientRequest = 4,
  kClientResponse = 5,
};

class Endpoint {
 public:
  uint16_t id() const { return id_; }
  const char* name() const { return name_; }

 protected:
  Endpoint(Kind kind, const char* name, FlashText type, FlashText md5)
      : kind_(kind), name_(name), type_(type), md5_(md5) {}
  Endpoint(const Endpoint&) = default;
  Endpoint& operator=(const Endpoint&) = delete;  // whether a node has linked it
  ~Endpoint() {}

  Node* node() const { return node_; }  // nullptr: not announced
  FlashText type() const { return type_; }

 private:
  friend class Node;

  Kind kind_;
  uint16_t id_ = 0;
  const char* name_;
  FlashText type_;
  FlashText md5_;
  Node* node_ = nullptr;
  Endpoint* next_ = nullptr;
};

// An endpoint for messages to the host.
class Sender : public Endpoint {
 protected:
  Sender(Kind kind, const char* name, FlashText type, FlashText md5) : Endpoint(kind, name, type, md5) {}

 private:
  friend class Node;
};

// An endpoint for messages from the host.
class Receiver : public Endpoint {
 protected:
  // False: the payload is damaged. The function may write to the payload, which is invalid after the call.
  typedef bool (*Receive)(Receiver& self, uint8_t* payload, size_t size);

  Receiver(Kind kind, const char* name, FlashText type, FlashText md5, Size size, Receive receive)
      : Endpoint(kind, name, type, md5), size_(size), receive_(receive) {}

 private:
  friend class Node;

  Size size_;
  Receive receive_;
};

}  // namespace ros
