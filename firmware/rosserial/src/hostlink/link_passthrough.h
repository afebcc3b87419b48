// A board with a network between a host and a board without a network: forwards the device's UART in both directions.
// Bytes pass unchanged, so topics, services and parameters are the device's. A lost connection stops the device.
#pragma once

#include <string.h>

#include "../ros/link.h"

namespace hostlink {

template <size_t kBytes = 512>
class LinkPassthrough {
  static_assert(kBytes >= 32, "a frame that stops the device needs its room");

 public:
  // `device` and `host` are initialised by the sketch.
  LinkPassthrough(ros::Link& device, ros::Link& host) : device_(device), host_(host) {}

  // One turn, which never waits: forwards in each direction at most what the buffer takes.
  void spin() {
    read_host();
    to_device_.flush(device_, &begun_);
    read_device();
    to_host_.flush(host_);
  }

  uint32_t dropped() const { return dropped_; }  // bytes of the device that the host did not accept in time

 private:
  // A frame that the device has received in part: the device would take the following bytes for its rest.
  class BegunFrame {
   public:
    bool is_begun() const { return at_ > 0; }
    // Filler that ends the frame as soon as possible, and always with a wrong checksum.
    uint8_t bad_byte() const {
      const bool is_check = at_ == kSizeBytes || (at_ > kSizeBytes && left_ == 1);
      return is_check ? static_cast<uint8_t>(0xFE - sum_) : 0;
    }
    void pass(uint8_t byte) {
      const size_t at = at_++;
      if (at == 0) {
        if (byte != 0xFF) at_ = 0;
      } else if (at == 1) {
        if (byte != 0xFE) at_ = byte == 0xFF ? 1 : 0;
        left_ = sum_ = 0;
      } else if (at < kSizeBytes) {
        left_ |= static_cast<uint32_t>(byte) << (at == 2 ? 0 : 8);
        sum_ = static_cast<uint8_t>(sum_ + byte);
      } else if (at == kSizeBytes) {
        if (static_cast<uint8_t>(sum_ + byte) != 0xFF) at_ = 0;
        left_ += kIdAndCheckBytes;
        sum_ = 0;
      } else {
        at_ = kSizeBytes + 1;
        sum_ = static_cast<uint8_t>(sum_ + byte);
        if (--left_ == 0) at_ = 0;
      }
    }

   private:
    static const size_t kSizeBytes = 4;  // of the header; the check of the size follows them
    static const uint32_t kIdAndCheckBytes = 3;

    size_t at_ = 0;
    uint32_t left_ = 0;
    uint8_t sum_ = 0;
  };

  class Waiting {
   public:
    bool has_room() const { return size_ < kBytes; }
    void put(int byte) { bytes_[size_++] = static_cast<uint8_t>(byte); }
    void clear() { size_ = 0; }
    size_t room() const { return kBytes - size_; }
    void flush(ros::Link& link, BegunFrame* begun = nullptr) {
      if (size_ == 0) return;
      const size_t accepted = ros::accepted_of(size_, link.write(bytes_, size_));
      for (size_t i = 0; begun != nullptr && i < accepted; ++i) begun->pass(bytes_[i]);
      size_ -= accepted;
      memmove(bytes_, bytes_ + accepted, size_);
    }

   private:
    uint8_t bytes_[kBytes] = {};
    size_t size_ = 0;
  };

  // Bytes that do not fit stay with the host: TCP slows it down.
  void read_host() {
    for (size_t count = 0; count < kBytes && to_device_.has_room(); ++count) {
      const int byte = host_.read();
      if (byte == ros::Link::kRestarted) {
        restart();
      } else if (byte < 0) {
        return;
      } else {
        to_device_.put(byte);
      }
    }
  }

  // A UART cannot be slowed down: bytes that do not fit are dropped, so that no old bytes wait for a host.
  void read_device() {
    for (size_t count = 0; count < kBytes; ++count) {
      const int byte = device_.read();
      if (byte < 0) return;
      if (to_host_.has_room()) {
        to_host_.put(byte);
      } else {
        ++dropped_;
      }
    }
  }

  // The host is lost, or another one connected: bytes of the old one are dropped, and the device stops its motors.
  void restart() {
    static const uint8_t kStop[] = {0xFF, 0xFE, 0x00, 0x00, 0xFF, 0x0B, 0x00, 0xF4};  // id 11: docs/protocol.md
    to_device_.clear();
    to_host_.clear();
    for (size_t count = 0; count < kBytes && device_.read() >= 0;) ++count;
    for (BegunFrame frame = begun_; frame.is_begun() && to_device_.room() > sizeof kStop;) {
      const uint8_t byte = frame.bad_byte();
      to_device_.put(byte);
      frame.pass(byte);
    }
    for (size_t i = 0; i < sizeof kStop; ++i) to_device_.put(kStop[i]);
  }

  ros::Link& device_;
  ros::Link& host_;
  Waiting to_device_;
  Waiting to_host_;
  BegunFrame begun_;
  uint32_t dropped_ = 0;
};

}  // namespace hostlink
