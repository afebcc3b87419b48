#include "uart_ring.h"

namespace hostlink {

void UartRing::put_on_line(uint8_t byte, uint32_t now_us) {
  if (line_size_ == kLineBytes) return;
  if (line_size_ == 0) arrived_at_us_ = now_us;  // the line was idle: the byte begins now
  line_[(line_head_ + line_size_++) % kLineBytes] = byte;
}

void UartRing::run_until(uint32_t now_us) {
  if (baud_ == 0) return;
  const uint32_t byte_us = kBitsAByte * 1000000u / baud_;
  while (line_size_ > 0 && now_us - arrived_at_us_ >= byte_us) {
    arrived_at_us_ += byte_us;
    const uint8_t byte = line_[line_head_];
    line_head_ = (line_head_ + 1) % kLineBytes;
    --line_size_;
    if (ring_size_ == kRingBytes) {
      ++lost_;
    } else {
      ring_[(ring_head_ + ring_size_++) % kRingBytes] = byte;
    }
  }
}

int UartRing::read() {
  if (baud_ == 0) {
    if (line_size_ == 0) return -1;
    const uint8_t byte = line_[line_head_];
    line_head_ = (line_head_ + 1) % kLineBytes;
    --line_size_;
    return byte;
  }
  if (ring_size_ == 0) return -1;
  const uint8_t byte = ring_[ring_head_];
  ring_head_ = (ring_head_ + 1) % kRingBytes;
  --ring_size_;
  return byte;
}

}  // namespace hostlink
