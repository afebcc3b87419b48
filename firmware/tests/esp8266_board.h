// Ports in memory: the input and the output of a Passthrough.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "src/ports.h"

namespace test {

using Bytes = std::vector<uint8_t>;

inline size_t move_out(Bytes& from, uint8_t* to, size_t limit) {
  const size_t count = std::min(limit, from.size());
  std::copy_n(from.begin(), count, to);
  from.erase(from.begin(), from.begin() + static_cast<std::ptrdiff_t>(count));
  return count;
}

class MemoryUart : public hostlink::Uart {
 public:
  size_t read(uint8_t* bytes, size_t limit_bytes) override { return move_out(from_device, bytes, limit_bytes); }
  size_t room_bytes() override { return room; }
  size_t write(const uint8_t* bytes, size_t count) override {
    const size_t taken = std::min(count, room);
    to_device.insert(to_device.end(), bytes, bytes + taken);
    is_overrun = is_overrun || count > room;
    room -= taken;
    return taken;
  }

  Bytes from_device, to_device;
  size_t room = 128;
  bool is_overrun = false;
};

class MemoryNetwork : public hostlink::Network {
 public:
  bool is_joined() override { return joined; }
  int signal_dbm() override { return signal; }
  void rejoin() override { ++rejoins; }
  bool connect() override { return connected = true; }
  bool is_connected() override { return connected; }
  size_t read(uint8_t* bytes, size_t limit_bytes) override { return move_out(from_host, bytes, limit_bytes); }
  size_t room_bytes() override { return connected ? room : 0; }
  size_t write(const uint8_t* bytes, size_t count) override {
    const size_t taken = std::min({count, room, write_limit});
    if (taken > 0) writes.emplace_back(bytes, bytes + taken);
    room -= taken;
    return taken;
  }
  void close() override {
    connected = false;
    from_host.clear();
    ++closes;
  }

  Bytes from_host;
  std::vector<Bytes> writes;
  size_t room = 2920;
  size_t write_limit = SIZE_MAX;
  int signal = 31;  // dBm; the core's value for no signal
  bool joined = true;
  bool connected = false;
  int rejoins = 0;
  int closes = 0;
};

inline Bytes frame(uint16_t topic_id, const Bytes& payload) {
  const auto size = static_cast<uint16_t>(payload.size());
  const auto low = [](unsigned value) { return static_cast<uint8_t>(value); };
  Bytes bytes = {0xff,
                 0xfe,
                 low(size),
                 low(size >> 8),
                 low(255 - (low(size) + low(size >> 8)) % 256),
                 low(topic_id),
                 low(topic_id >> 8)};
  bytes.insert(bytes.end(), payload.begin(), payload.end());
  unsigned sum = 0;
  for (size_t i = 5; i < bytes.size(); ++i) sum += bytes[i];
  bytes.push_back(low(255 - sum % 256));
  return bytes;
}

inline Bytes operator+(Bytes left, const Bytes& right) {
  left.insert(left.end(), right.begin(), right.end());
  return left;
}

}  // namespace test
