#include "frame_queue.h"

#include <string.h>

namespace ros {

Writer FrameQueue::open() {
  memmove(bytes_, bytes_ + head_, size_);
  head_ = 0;
  return Writer(bytes_ + size_ + kHeaderBytes, has_room(0) ? capacity_ - size_ - kOverheadBytes : 0);
}

bool FrameQueue::make_room(uint16_t id, size_t payload_bytes) {
  if (payload_bytes > payload_bytes_max_) return false;
  const Rank for_rank = rank(id);
  size_t staying = begun_bytes_;
  for (size_t at = head_ + begun_bytes_; at < head_ + size_; at += frame_bytes(at)) {
    const Rank of_frame = rank(frame_id(at));
    if (of_frame != Rank::kMessage && of_frame >= for_rank) staying += frame_bytes(at);
  }
  if (payload_bytes + kOverheadBytes > capacity_ - staying) return false;
  Rank dropped = Rank::kMessage;
  while (!has_room(payload_bytes)) {
    if (!drop_oldest(dropped)) dropped = Rank::kLine;
  }
  return true;
}

void FrameQueue::close(uint16_t id, size_t payload_bytes) {
  uint8_t* frame = bytes_ + size_;
  const uint8_t low = static_cast<uint8_t>(payload_bytes);
  const uint8_t high = static_cast<uint8_t>(payload_bytes >> 8);
  frame[0] = 0xFF;
  frame[1] = 0xFE;
  frame[2] = low;
  frame[3] = high;
  frame[4] = static_cast<uint8_t>(~(low + high));
  frame[5] = static_cast<uint8_t>(id);
  frame[6] = static_cast<uint8_t>(id >> 8);
  uint8_t sum = 0;
  for (size_t i = kHeaderBytes - 2; i < kHeaderBytes + payload_bytes; ++i) sum = static_cast<uint8_t>(sum + frame[i]);
  frame[kHeaderBytes + payload_bytes] = static_cast<uint8_t>(~sum);
  size_ += payload_bytes + kOverheadBytes;
}

bool FrameQueue::flush(Link& link) {
  size_t taken = size_;
  while (size_ > 0 && taken > 0) {
    taken = accepted_of(size_, link.write(bytes_ + head_, size_));
    leave(taken);
  }
  return size_ > 0;
}

void FrameQueue::clear() { head_ = size_ = begun_bytes_ = 0; }

FrameQueue::Rank FrameQueue::rank(uint16_t id) const {
  if (id == kIdLog) return Rank::kLine;
  return topics_.is_replaceable(id) ? Rank::kMessage : Rank::kAwaited;
}

// Rank of the frame that begins here, from its header.
size_t FrameQueue::frame_bytes(size_t at) const {
  return kOverheadBytes + (static_cast<size_t>(bytes_[at + 2]) | static_cast<size_t>(bytes_[at + 3]) << 8);
}

// The oldest frame of this rank that is not partly sent.
bool FrameQueue::drop_oldest(Rank of_rank) {
  const size_t end = head_ + size_;
  size_t at = head_ + begun_bytes_;
  while (at < end && rank(frame_id(at)) != of_rank) at += frame_bytes(at);
  if (at >= end) return false;
  const size_t gone = frame_bytes(at);
  memmove(bytes_ + at, bytes_ + at + gone, end - at - gone);
  size_ -= gone;
  ++(of_rank == Rank::kLine ? dropped_lines_ : dropped_);
  return true;
}

// This many bytes were sent: the frame whose rest must follow, if any.
void FrameQueue::leave(size_t count) {
  while (count > 0) {
    if (begun_bytes_ == 0) begun_bytes_ = frame_bytes(head_);
    const size_t step = count < begun_bytes_ ? count : begun_bytes_;
    head_ += step;
    size_ -= step;
    begun_bytes_ -= step;
    count -= step;
  }
}

}  // namespace ros
