#include "frame_reader.h"

#include <string.h>

namespace ros {

namespace {

const uint8_t kSync = 0xFF;
const uint8_t kVersion = 0xFE;
const size_t kSizeEnd = 5;  // of the size and its checksum
const size_t kHeaderBytes = 7;

uint8_t sum(const uint8_t* bytes, size_t count) {
  uint8_t total = 0;
  for (size_t i = 0; i < count; ++i) total = static_cast<uint8_t>(total + bytes[i]);
  return total;
}

}  // namespace

FrameReader::Result FrameReader::add(uint8_t byte) {
  drop(frame_bytes_);
  frame_bytes_ = 0;
  if (size_ == 0 && byte != kSync) return kNothing;
  bytes_[size_++] = byte;
  return judge();
}

FrameReader::Result FrameReader::again() {
  drop(frame_bytes_);
  frame_bytes_ = 0;
  return judge();
}

void FrameReader::give_up() {
  if (size_ > 0) fail();
}

void FrameReader::clear() { size_ = frame_bytes_ = 0; }

// Check the bytes at the start until they are a frame, may become one, or none are left. Each false start drops at
// least one byte, so this ends.
FrameReader::Result FrameReader::judge() {
  while (size_ >= 2) {
    if (bytes_[1] != kVersion) {
      fail();
      if (!rescans_) return kWrongVersion;
      continue;
    }
    if (is_false_start()) {
      fail();
      continue;
    }
    if (size_ < kHeaderBytes) return kNothing;
    const size_t frame_bytes = claimed_bytes() + kOverheadBytes;
    if (size_ < frame_bytes) return kNothing;
    if (sum(bytes_ + kSizeEnd, frame_bytes - kSizeEnd) != 0xFF) {
      fail();
      continue;
    }
    frame_bytes_ = frame_bytes;
    return kFrame;
  }
  return kNothing;
}

bool FrameReader::is_false_start() const {
  if (size_ < kSizeEnd) return false;
  if (sum(bytes_ + 2, kSizeEnd - 2) != 0xFF || claimed_bytes() > payload_bytes_max()) return true;
  return rescans_ && size_ >= kHeaderBytes && !topics_.is_expected(topic_id(), claimed_bytes());
}

// The first byte starts no frame: continue with the next possible one, or drop everything.
void FrameReader::fail() {
  ++dropped_;
  if (!rescans_) {
    size_ = 0;
    return;
  }
  size_t next = 1;
  while (next < size_ && bytes_[next] != kSync) ++next;
  drop(next);
}

void FrameReader::drop(size_t count) {
  size_ -= count;
  memmove(bytes_, bytes_ + count, size_);
}

}  // namespace ros
