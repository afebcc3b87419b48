// A TCP connection to the host that reconnects when it is lost: over a client of an Arduino core, such as WiFiClient or
// EthernetClient. Only the client's own connect() waits.
#pragma once

#include <Arduino.h>
#include <IPAddress.h>

#include "../ros/link.h"
#include "backoff.h"

namespace hostlink {

const uint16_t kHostPort = 11411;

template <class Client>
class ClientHardware : public ros::Link {
 public:
  // Call it before initNode(). The name must stay valid; an address saves the look-up at each connect.
  void setConnection(const char* host, uint16_t port = kHostPort) {
    name_ = host;
    port_ = port;
  }
  void setConnection(IPAddress host, uint16_t port = kHostPort) {
    name_ = nullptr;
    address_ = host;
    port_ = port;
  }
  // Whether connecting can succeed now; without this function: always.
  void setNetwork(bool (*is_up)()) { is_up_ = is_up; }

  void init() {}
  Client& client() { return client_; }

  void close() {
    client_.stop();
    lose();
  }

  int read() override {
    if (!is_lost_ && client_.available() > 0) {  // check before connected(): a host's last bytes are often a stop
      heard_at_ms_ = now_ms();
      return client_.read();
    }
    if (!is_connected_) {
      connect();
    } else if (!is_lost_ && (!client_.connected() || now_ms() - heard_at_ms_ > kSilenceMs)) {
      close();
    }
    if (!is_lost_) return kNothing;
    is_lost_ = false;
    return kRestarted;
  }

  size_t write(const uint8_t* bytes, size_t size) override {
    if (!is_connected_) return 0;
    const int room = client_.availableForWrite();  // more would wait for the host
    if (room <= 0) return 0;
    return client_.write(bytes, size < static_cast<size_t>(room) ? size : static_cast<size_t>(room));
  }

  uint32_t milliseconds() override {
    yield();
    return now_ms();
  }

 protected:
  bool is_connected() const { return is_connected_; }
  static uint32_t now_ms() { return static_cast<uint32_t>(millis()); }

 private:
  static const uint32_t kSilenceMs = 15000;  // a host answers every 2.5 s, and the node gives up after 11 s

  static const uint32_t kSteadyMs = 5000;

  void connect() {
    if ((is_up_ != nullptr && !is_up_()) || now_ms() - tried_at_ms_ < wait_ms_) return;
    client_.stop();
    is_connected_ = name_ != nullptr ? client_.connect(name_, port_) == 1 : client_.connect(address_, port_) == 1;
    tried_at_ms_ = heard_at_ms_ = now_ms();
    backoff_.stir(static_cast<uint32_t>(micros()));  // a fleet has one firmware
    wait_ms_ = backoff_.next_ms();
    if (!is_connected_) return;
    is_lost_ = true;  // queued bytes are not for another host
    set_options(client_, 0);
  }

  void lose() {
    if (is_connected_ && now_ms() - tried_at_ms_ > kSteadyMs) backoff_.reset();  // otherwise the host refuses the board
    is_connected_ = false;
    is_lost_ = true;
    wait_ms_ = backoff_.next_ms();
    tried_at_ms_ = now_ms();
  }

  // If the client has it: switch off Nagle's algorithm, which each connection starts with.
  template <class C>
  static auto set_options(C& client, int) -> decltype(client.setNoDelay(true), void()) {
    client.setNoDelay(true);
  }
  template <class C>
  static void set_options(C&, long) {}

  Client client_;
  const char* name_ = nullptr;
  IPAddress address_;
  uint16_t port_ = kHostPort;
  bool (*is_up_)() = nullptr;
  Backoff backoff_{1};
  uint32_t wait_ms_ = 0;
  uint32_t tried_at_ms_ = 0;
  uint32_t heard_at_ms_ = 0;
  bool is_connected_ = false;
  bool is_lost_ = false;
};

}  // namespace hostlink
