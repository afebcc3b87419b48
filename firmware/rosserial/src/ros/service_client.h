// A service that the board calls: one call at a time, each with a deadline.
#pragma once

#include "publisher.h"
#include "subscriber.h"

namespace ros {

const uint32_t kCallTimeoutMs = 1000;

/*
  The deadline of a call, whatever its messages are. An answer does not name its request: one that comes too late must
  not be the next call's.

  state    event                              next
  idle     start                              running
  running  the answer came                    idle
           the deadline, or the host is gone  late, expire()
  late     the answer came, 5 s, or the host is gone  idle
*/
class CallDeadline : public Task {
 public:
  bool is_running() const { return state_ == State::kRunning; }
  bool is_idle() const { return state_ == State::kIdle; }

 protected:
  void start(uint32_t now_ms, uint32_t timeout_ms);
  bool finish();  // an answer has arrived; false: no call waits for it
  virtual void expire() = 0;
  void spin(Node& node) override;

 private:
  enum class State : uint8_t { kIdle, kRunning, kLate };

  uint32_t since_ms_ = 0;
  uint32_t timeout_ms_ = 0;
  State state_ = State::kIdle;
};

// `kArrayBytes`: for the elements of the response's variable arrays.
template <class Request, class Response, size_t kArrayBytes = 0>
class ServiceClient : public Receiver, public CallDeadline {
 public:
  // The response, or nullptr after the deadline; it is invalid after the callback.
  typedef Callable<void(const Response*)> Callback;

  explicit ServiceClient(const char* service)
      : Receiver(Kind::kClientResponse, service, Response::getType(), Response::getMD5(), Response::getSize(),
                 &ServiceClient::receive),
        request_(service) {}

  // Never waits. False: a call is running or was given up less than 5 s ago, or the request was not queued; then the
  // callback is not called.
  template <class F>
  bool begin(const Request& request, F callback, uint32_t timeout_ms = kCallTimeoutMs) {
    if (!is_idle()) return false;
    callback_ = Callback(callback);
    return send(request, timeout_ms);
  }

  // Runs turns until the response has arrived, like ros_lib, but with a deadline. Its texts and arrays stay until the
  // next turn. False: no response, or this is a callback.
  bool call(const Request& request, Response& response, uint32_t timeout_ms = kCallTimeoutMs) {
    Node* node = Receiver::node();
    if (!is_idle() || node == nullptr || !node->can_wait()) return false;
    callback_ = Callback();
    waiting_ = &response;
    is_done_ = is_answered_ = false;
    const bool is_sent = send(request, timeout_ms);
    // The deadline also ends the call; a little later if that turn is missed.
    if (is_sent) node->spin_until(is_done_, timeout_ms == UINT32_MAX ? timeout_ms : timeout_ms + 1);
    waiting_ = nullptr;
    return is_answered_;
  }

  Sender& request() { return request_; }  // the other half of the service

 private:
  struct Question : public Sender {
    explicit Question(const char* service)
        : Sender(Kind::kClientRequest, service, Request::getType(), Request::getMD5()) {}
  };

  bool send(const Request& request, uint32_t timeout_ms) {
    Node* node = Receiver::node();
    if (node == nullptr) return false;
    if (!node->is_configured() || node->publish(request_, &request, &serialize_message<Request>) < 0) return false;
    start(node->milliseconds(), timeout_ms);
    return true;
  }

  static bool receive(Receiver& self, uint8_t* payload, size_t size) {
    ServiceClient& client = static_cast<ServiceClient&>(self);
    if (!client.finish()) return false;
    Reader in(payload, size, client.storage_.start(), kArrayBytes);
    Response response;
    Response& read = client.waiting_ == nullptr ? response : *client.waiting_;
    const bool is_good = read.deserialize(in) && in.left() == 0;
    client.end(is_good ? &read : nullptr);
    return is_good;
  }

  void expire() override { end(nullptr); }

  void end(const Response* response) {
    is_done_ = true;
    is_answered_ = response != nullptr;
    Callback callback = callback_;
    callback(response);
  }

  Question request_;
  Callback callback_;
  Response* waiting_ = nullptr;
  Storage<Response::getSize().is_fixed() ? 0 : kArrayBytes> storage_;
  bool is_done_ = false;
  bool is_answered_ = false;
};

}  // namespace ros
