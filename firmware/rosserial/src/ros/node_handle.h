// The node with ros_lib's names, with its buffers and its hardware.
#pragma once

#include "node.h"
#include "publisher.h"
#include "raw.h"
#include "service_client.h"
#include "service_server.h"
#include "subscriber.h"

class __FlashStringHelper;  // the type of Arduino's F("...")

namespace ros {

const int SPIN_OK = 0;
const int SPIN_ERR = -1;
const int SPIN_TIMEOUT = -2;

const uint32_t kParameterTimeoutMs = 1000;

// A hardware of ros_lib as a link: init(), read(), write() without a result, time().
template <class Hardware>
class HardwareLink : public Link {
 public:
  Hardware& hardware() { return hardware_; }

  int read() override { return hardware_.read(); }
  size_t write(const uint8_t* bytes, size_t size) override {
    hardware_.write(const_cast<uint8_t*>(bytes), static_cast<int>(size));
    return size;
  }
  uint32_t milliseconds() override { return static_cast<uint32_t>(hardware_.time()); }

 private:
  Hardware hardware_;
};

// A hardware that is already a link.
template <class Hardware>
class OwnLink : public Hardware {
 public:
  Hardware& hardware() { return *this; }
};

template <class Hardware>
class LinkOf {
  static OwnLink<Hardware> choose(const Link*);
  static HardwareLink<Hardware> choose(const void*);

 public:
  typedef decltype(choose(static_cast<Hardware*>(nullptr))) Type;
};

// The names of ros_lib.
class NodeApi : public Node {
 public:
  int spinOnce() {
    spin();
    return SPIN_OK;
  }
  bool connected() const { return is_configured(); }
  void setNamespace(const char* name_space) { set_namespace(name_space); }

  bool advertise(Sender& publisher) { return add(publisher); }
  bool subscribe(RawSubscriber& subscriber) { return add(subscriber); }
  template <class M, class T, size_t kArrayBytes>
  bool subscribe(Subscriber<M, T, kArrayBytes>& subscriber) {
    return add(subscriber);
  }
  template <class Request, class Response, class T, size_t kArrayBytes>
  bool advertiseService(ServiceServer<Request, Response, T, kArrayBytes>& server) {
    return add(server.response(), server);
  }
  template <class Request, class Response, size_t kArrayBytes>
  bool serviceClient(ServiceClient<Request, Response, kArrayBytes>& client) {
    if (!add(client.request(), client)) return false;
    attach(client);
    return true;
  }

  Time now() { return clock().now(milliseconds()); }
  void setNow(const Time& time) { clock().set(time, milliseconds()); }

  void logdebug(const char* text) { log(Level::kDebug, text); }
  void loginfo(const char* text) { log(Level::kInfo, text); }
  void logwarn(const char* text) { log(Level::kWarn, text); }
  void logerror(const char* text) { log(Level::kError, text); }
  void logfatal(const char* text) { log(Level::kFatal, text); }
  void logdebug(const __FlashStringHelper* text) { log(Level::kDebug, in_flash(text)); }
  void loginfo(const __FlashStringHelper* text) { log(Level::kInfo, in_flash(text)); }
  void logwarn(const __FlashStringHelper* text) { log(Level::kWarn, in_flash(text)); }
  void logerror(const __FlashStringHelper* text) { log(Level::kError, in_flash(text)); }
  void logfatal(const __FlashStringHelper* text) { log(Level::kFatal, in_flash(text)); }

  // Run turns until the answer has arrived, like ros_lib; before that, for at most the same time, until the answer to
  // an earlier request has arrived. False: the parameter is missing, has another type or another length, or this is a
  // callback; and the values stay as they are.
  bool getParam(const char* name, int* values, int length = 1, uint32_t timeout_ms = kParameterTimeoutMs) {
    Wanted<int> wanted = {values, length, false, false};
    return get(name, wanted, timeout_ms);
  }
  bool getParam(const char* name, float* values, int length = 1, uint32_t timeout_ms = kParameterTimeoutMs) {
    Wanted<float> wanted = {values, length, false, false};
    return get(name, wanted, timeout_ms);
  }
  bool getParam(const char* name, bool* values, int length = 1, uint32_t timeout_ms = kParameterTimeoutMs) {
    Wanted<bool> wanted = {values, length, false, false};
    return get(name, wanted, timeout_ms);
  }
  template <size_t kChars>
  bool getParam(const char* name, char (&text)[kChars], uint32_t timeout_ms = kParameterTimeoutMs) {
    Wanted<char> wanted = {text, static_cast<int>(kChars), false, false};
    return get(name, wanted, timeout_ms);
  }

 protected:
  using Node::Node;

 private:
  template <class T>
  struct Wanted {
    T* values;
    int length;
    bool is_done;
    bool is_found;
  };

  static FlashText in_flash(const __FlashStringHelper* text) { return FlashText(reinterpret_cast<const char*>(text)); }

  template <class T>
  bool get(const char* name, Wanted<T>& wanted, uint32_t timeout_ms) {
    if (!is_configured() || !can_wait()) return false;
    const uint32_t began_ms = milliseconds();
    while (!request_parameter(name, &receive<T>, &wanted)) {
      if (!is_configured() || milliseconds() - began_ms > timeout_ms) return false;
      spin();
    }
    if (!spin_until(wanted.is_done, timeout_ms)) forget_parameter(&wanted);
    return wanted.is_found;
  }

  template <class T>
  static void receive(void* context, ParameterAnswer& answer) {
    Wanted<T>& wanted = *static_cast<Wanted<T>*>(context);
    wanted.is_found = answer.copy(wanted.values, static_cast<size_t>(wanted.length));
    wanted.is_done = true;
  }
};

// INPUT_SIZE, OUTPUT_SIZE: the largest message from and to the host, in bytes. QUEUE_SIZE: of the messages, with 8
// bytes each, that wait for the line.
template <int MAX_SUBSCRIBERS = 25, int MAX_PUBLISHERS = 25, int INPUT_SIZE = 512, int OUTPUT_SIZE = 512,
          int QUEUE_SIZE = OUTPUT_SIZE + 8>
class BufferedNode : public NodeApi {
  static_assert(MAX_SUBSCRIBERS >= 0 && MAX_PUBLISHERS >= 0, "the numbers of topics are not negative");
  static_assert(MAX_SUBSCRIBERS <= 30000 && MAX_PUBLISHERS <= 30000, "an id has 16 bits");
  static_assert(INPUT_SIZE <= 65535L && OUTPUT_SIZE <= 65535L, "a frame has 65535 bytes of payload at most");
  static_assert(INPUT_SIZE >= 32, "an answer of the host needs 32 bytes");
  static_assert(OUTPUT_SIZE >= 64 && QUEUE_SIZE >= OUTPUT_SIZE + 8, "the announcement of a topic needs its room");

 public:
  explicit BufferedNode(Link& link, Retry retry = Retry::kKeepState)
      : NodeApi(link, {input_, sizeof input_, queue_, sizeof queue_, OUTPUT_SIZE}, MAX_SUBSCRIBERS, MAX_PUBLISHERS,
                retry) {}

 private:
  uint8_t input_[INPUT_SIZE + kOverheadBytes] = {};
  uint8_t queue_[QUEUE_SIZE] = {};
};

// A node with its hardware, which is a Link with init(), or a hardware of ros_lib.
template <class Hardware, int MAX_SUBSCRIBERS = 25, int MAX_PUBLISHERS = 25, int INPUT_SIZE = 512,
          int OUTPUT_SIZE = 512, int QUEUE_SIZE = OUTPUT_SIZE + 8>
class NodeHandle_ : public BufferedNode<MAX_SUBSCRIBERS, MAX_PUBLISHERS, INPUT_SIZE, OUTPUT_SIZE, QUEUE_SIZE> {
 public:
  NodeHandle_() : BufferedNode<MAX_SUBSCRIBERS, MAX_PUBLISHERS, INPUT_SIZE, OUTPUT_SIZE, QUEUE_SIZE>(link_) {}

  Hardware* getHardware() { return &link_.hardware(); }

  template <class... Arguments>
  void initNode(Arguments... arguments) {
    link_.hardware().init(arguments...);
  }

 private:
  typename LinkOf<Hardware>::Type link_;
};

}  // namespace ros
