#include "uart_out.h"

namespace hostlink {

size_t UartOut::put(const uint8_t* data, size_t size, uint32_t now_us) {
  ready(now_us);
  if (through_ == size_) through_at_us_ = now_us;  // the line was idle: the byte begins now
  size_t accepted = 0;
  while (accepted < size && size_ < kRingBytes) ring_[(head_ + size_++) % kRingBytes] = data[accepted++];
  return accepted;
}

size_t UartOut::ready(uint32_t now_us) {
  if (baud_ == 0) through_ = size_;
  const uint32_t byte_us = baud_ == 0 ? 0 : kBitsAByte * 1000000u / baud_;
  while (through_ < size_ && now_us - through_at_us_ >= byte_us) {
    through_at_us_ += byte_us;
    ++through_;
  }
  const size_t to_end = kRingBytes - head_;
  return through_ < to_end ? through_ : to_end;
}

void UartOut::drop(size_t count) {
  head_ = (head_ + count) % kRingBytes;
  size_ -= count;
  through_ -= count;
}

}  // namespace hostlink
