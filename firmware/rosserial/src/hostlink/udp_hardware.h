// Datagrams to the host and from it, by WiFiUDP or EthernetUDP: [udp] in hostlink's configuration. Lost datagrams are
// not sent again.
#pragma once

#include <Arduino.h>
#include <IPAddress.h>

#include "../ros/link.h"

namespace hostlink {

template <class Udp>
class UdpHardware : public ros::Link {
 public:
  // Also later: for another host the node starts again like a new board.
  void setConnection(IPAddress host, uint16_t port = 11411, uint16_t own_port = 11411) {
    is_lost_ = is_lost_ || (has_begun_ && !(host == host_ && port == port_));
    host_ = host;
    port_ = port;
    own_port_ = own_port;
  }
  // Whether the network is up; without this function: always.
  void setNetwork(bool (*is_up)()) { is_up_ = is_up; }

  void init() {}

  int read() override {
    if (!begin()) return kNothing;
    if (is_lost_) return lose();
    for (uint8_t count = 0; udp_.available() <= 0; ++count) {
      if (count == kForeignDatagrams || udp_.parsePacket() <= 0) {
        greet();
        return kNothing;
      }
      if (udp_.remoteIP() == host_ && udp_.remotePort() == port_) {
        heard_at_ms_ = now_ms();
      } else {
        drop_datagram();  // anyone can send a datagram
      }
    }
    return udp_.read();
  }

  size_t write(const uint8_t* bytes, size_t size) override {
    if (!has_begun_) return 0;
    const size_t count = size < kDatagramBytes ? size : kDatagramBytes;
    if (udp_.beginPacket(host_, port_) != 1) return 0;
    const size_t written = udp_.write(bytes, count);
    udp_.endPacket();
    return written;
  }

  uint32_t milliseconds() override {
    yield();
    return now_ms();
  }

 private:
  static const size_t kDatagramBytes = 1400;
  static const uint8_t kForeignDatagrams = 16;  // in one turn: a flood must not block the loop
  static const uint32_t kGreetingMs = 1000;
  static const uint32_t kSilenceMs = 4000;  // a host that knows the board answers every 2.5 s

  static uint32_t now_ms() { return static_cast<uint32_t>(millis()); }

  bool begin() {
    const bool is_up = is_up_ == nullptr || is_up_();
    if (!has_begun_ && is_up) has_begun_ = udp_.begin(own_port_) == 1;
    return has_begun_ && is_up;
  }

  int lose() {
    is_lost_ = false;
    heard_at_ms_ = 0;
    drop_datagram();
    return kRestarted;
  }

  // parsePacket() of an ESP32 finds the next one only after this one was read.
  void drop_datagram() {
    uint8_t bytes[64];
    while (udp_.available() > 0 && udp_.read(bytes, sizeof bytes) > 0) {
    }
  }

  // A host does not know a device that has sent nothing: send a request for the time.
  void greet() {
    static const uint8_t kRequest[] = {0xFF, 0xFE, 8, 0, 0xF7, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xF5};
    if ((heard_at_ms_ != 0 && now_ms() - heard_at_ms_ < kSilenceMs) || now_ms() - greeted_at_ms_ < kGreetingMs) return;
    greeted_at_ms_ = now_ms();
    write(kRequest, sizeof kRequest);
  }

  Udp udp_;
  IPAddress host_;
  uint16_t port_ = 11411;
  uint16_t own_port_ = 11411;
  bool (*is_up_)() = nullptr;
  bool has_begun_ = false;
  bool is_lost_ = false;
  uint32_t heard_at_ms_ = 0;
  uint32_t greeted_at_ms_ = 0;
};

}  // namespace hostlink
