// UartRing: the Due's UART buffer for bytes from a line of its baud rate: 127 bytes. Bytes that do not fit are lost.
// Bytes wait in a larger line buffer until their time; when that is full the sender must wait.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace hostlink {

class UartRing {
 public:
  static const size_t kRingBytes = 127;
  static const size_t kLineBytes = 4096;

  explicit UartRing(uint32_t baud) : baud_(baud) {}  // 0: bytes arrive at once, and none is lost

  size_t line_room() const { return kLineBytes - line_size_; }
  void put_on_line(uint8_t byte, uint32_t now_us);
  void run_until(uint32_t now_us);
  int read();
  bool is_idle() const { return line_size_ == 0 && ring_size_ == 0; }
  uint32_t lost() const { return lost_; }

 private:
  static const uint32_t kBitsAByte = 10;

  uint32_t baud_;
  uint8_t line_[kLineBytes] = {};
  size_t line_head_ = 0;
  size_t line_size_ = 0;
  uint8_t ring_[kRingBytes] = {};
  size_t ring_head_ = 0;
  size_t ring_size_ = 0;
  uint32_t arrived_at_us_ = 0;  // when the last byte has passed
  uint32_t lost_ = 0;
};

}  // namespace hostlink
