// Shared parts of the tests of the library's node: a scripted host and a small node. docs/protocol.md describes the
// behaviour of the hosts.
#pragma once

#include <ros/node_handle.h>
#include <string.h>

#include "check.h"
#include "rosserial_messages.h"

const size_t kBytes = 8192;

// A line on which each look at the clock takes `step_ms`.
struct TestLink : public ros::Link {
  uint32_t now_ms = 0xFFFFF000u;  // wraps within four seconds
  uint32_t step_ms = 0;
  uint8_t from_host[kBytes];
  size_t from_host_at = 0;
  size_t from_host_size = 0;
  uint8_t to_host[kBytes];
  size_t to_host_size = 0;
  size_t room = kBytes;
  bool is_restarted = false;

  int read() override {
    if (is_restarted) {
      is_restarted = false;
      return kRestarted;
    }
    return from_host_at < from_host_size ? from_host[from_host_at++] : static_cast<int>(kNothing);
  }
  size_t write(const uint8_t* bytes, size_t size) override {
    const size_t free_bytes = kBytes - to_host_size < room ? kBytes - to_host_size : room;
    const size_t taken = size < free_bytes ? size : free_bytes;
    memcpy(to_host + to_host_size, bytes, taken);
    to_host_size += taken;
    room -= taken;
    return taken;
  }
  uint32_t milliseconds() override { return now_ms += step_ms; }

  void put(const uint8_t* bytes, size_t size) {
    for (size_t i = 0; i < size; ++i) from_host[from_host_size + i] = bytes[i];
    from_host_size += size;
  }
  void put_frame(uint16_t id, const uint8_t* payload, size_t size) {
    const uint8_t low = static_cast<uint8_t>(size);
    const uint8_t high = static_cast<uint8_t>(size >> 8);
    const uint8_t header[7] = {0xFF,
                               0xFE,
                               low,
                               high,
                               static_cast<uint8_t>(~(low + high)),
                               static_cast<uint8_t>(id),
                               static_cast<uint8_t>(id >> 8)};
    uint8_t sum = static_cast<uint8_t>(header[5] + header[6]);
    for (size_t i = 0; i < size; ++i) sum = static_cast<uint8_t>(sum + payload[i]);
    sum = static_cast<uint8_t>(~sum);
    put(header, sizeof header);
    put(payload, size);
    put(&sum, 1);
  }
  void put_number(uint16_t id, int32_t number) {
    uint8_t payload[4];
    ros::Writer out(payload, sizeof payload);
    out.put(number);
    put_frame(id, payload, sizeof payload);
  }
  void put_time(uint32_t sec, uint32_t nsec) {
    uint8_t payload[8];
    ros::Writer out(payload, sizeof payload);
    out.put(ros::Time(sec, nsec));
    put_frame(10, payload, sizeof payload);
  }
  void request_topics() { put_frame(0, nullptr, 0); }

  // Payload and id of the frame of this number that was sent; -1: there are fewer.
  int sent(size_t number, const uint8_t*& payload, size_t& size) const {
    for (size_t at = 0; at + 8 <= to_host_size; at += size + 8) {
      size = static_cast<size_t>(to_host[at + 2] | to_host[at + 3] << 8);
      payload = to_host + at + 7;
      if (number-- == 0) return to_host[at + 5] | to_host[at + 6] << 8;
    }
    return -1;
  }
  int sent_id(size_t number) const {
    const uint8_t* payload = nullptr;
    size_t size = 0;
    return sent(number, payload, size);
  }
  size_t sent_frames() const {
    size_t count = 0;
    while (sent_id(count) >= 0) ++count;
    return count;
  }
  void clear() { to_host_size = 0; }
};

// Its write() accepts all bytes, and returns something else.
struct LyingLink : public TestLink {
  size_t answer = SIZE_MAX;  // the -1 of an error
  size_t write(const uint8_t* bytes, size_t size) override {
    TestLink::write(bytes, size);
    return answer;
  }
};

typedef ros::BufferedNode<4, 3, 64, 128> TestNode;
typedef test_msgs::Number Number;
typedef test_msgs::Words Words;

inline void connect(TestLink& link, ros::NodeApi& node) {
  link.request_topics();
  node.spinOnce();
  link.clear();
}

void run_topics_tests();
void run_calls_tests();
void run_time_tests();
void run_hostile_tests();
void run_hosts_tests();
void run_passthrough_tests();
