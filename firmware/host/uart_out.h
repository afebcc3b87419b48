// UartOut: the Due's UART towards the host: a ring of 128 bytes that a line of its baud rate empties.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace hostlink {

class UartOut {
 public:
  static const size_t kRingBytes = 128;

  explicit UartOut(uint32_t baud) : baud_(baud) {}  // 0: bytes pass at once

  size_t put(const uint8_t* data, size_t size, uint32_t now_us);  // adds what fits
  // The bytes that have passed and were not dropped yet: this many in one piece, at data().
  size_t ready(uint32_t now_us);
  const uint8_t* data() const { return ring_ + head_; }
  void drop(size_t count);
  bool is_idle() const { return size_ == 0; }

 private:
  static const uint32_t kBitsAByte = 10;

  uint32_t baud_;
  uint8_t ring_[kRingBytes] = {};
  size_t head_ = 0;
  size_t size_ = 0;
  size_t through_ = 0;          // of them
  uint32_t through_at_us_ = 0;  // when the last of those was
};

}  // namespace hostlink
