#include "frame_assembler.h"

#include <string.h>

namespace hostlink {

const size_t FrameAssembler::kOverheadBytes;
const size_t FrameAssembler::kPayloadBytesMax;
const size_t FrameAssembler::kFrameBytesMax;
const size_t FrameAssembler::kCapacityBytes;

namespace {
const uint8_t kSync = 0xff;
const uint8_t kVersion = 0xfe;
const size_t kHeaderBytes = 5;           // sync, version, length, checksum of the length
const size_t kNoiseBytes = 64;           // bytes outside frames are sent at this size without waiting
const size_t kUnalignedBytesMax = 1024;  // noise at power-up is shorter; more bytes are not rosserial

size_t least(size_t a, size_t b) { return a < b ? a : b; }
}  // namespace

void FrameAssembler::restart(uint32_t now_ms) {
  size_bytes_ = 0;
  started_bytes_ = 0;
  is_waiting_ = false;
  is_aligned_ = false;
  unaligned_bytes_ = 0;
  last_put_ms_ = now_ms;
}

size_t FrameAssembler::put(const uint8_t* bytes, size_t count, uint32_t now_ms) {
  const size_t taken = least(count, room_bytes());
  if (taken == 0) return 0;
  if (!is_aligned_ && now_ms - last_put_ms_ >= hold_.quiet_ms) {
    erase(0, size_bytes_);
    is_aligned_ = true;
  }
  memcpy(bytes_ + size_bytes_, bytes, taken);
  size_bytes_ += taken;
  last_put_ms_ = now_ms;
  if (!is_aligned_) align();
  return taken;
}

void FrameAssembler::align() {
  size_t at = 0;
  while (at < size_bytes_ && !could_start_frame(at) && unaligned_bytes_ + at < kUnalignedBytesMax) ++at;
  erase(0, at);
  unaligned_bytes_ += at;
  swallowed_bytes_ += static_cast<uint32_t>(at);
  is_aligned_ = size_bytes_ >= kHeaderBytes || unaligned_bytes_ >= kUnalignedBytesMax;
}

size_t FrameAssembler::ready_bytes(size_t limit_bytes, uint32_t now_ms) {
  if (!is_aligned_ || limit_bytes == 0) return 0;
  size_t end = least(started_bytes_, limit_bytes);
  while (end < size_bytes_ && end < limit_bytes) {
    const Piece piece = piece_at(end);
    if (!piece.is_whole && !has_waited_enough(end, now_ms)) break;
    if (end + piece.bytes > limit_bytes) return piece.is_frame && piece.is_whole ? end : limit_bytes;
    end += piece.bytes;
  }
  return end;
}

bool FrameAssembler::has_waited_enough(size_t at, uint32_t now_ms) {
  if (!is_waiting_ || waiting_at_ != at) {
    is_waiting_ = true;
    waiting_at_ = at;
    waiting_since_ms_ = now_ms;
  }
  return now_ms - last_put_ms_ >= hold_.quiet_ms || now_ms - waiting_since_ms_ >= hold_.longest_ms;
}

void FrameAssembler::take(size_t count) {
  const size_t taken = least(count, size_bytes_);
  size_t end = started_bytes_;
  bool is_frame = true;
  while (end < taken) {
    const Piece piece = piece_at(end);
    is_frame = piece.is_frame && piece.is_whole;
    end += piece.bytes;
  }
  started_bytes_ = is_frame ? end - taken : 0;
  memmove(bytes_, bytes_ + taken, size_bytes_ - taken);
  size_bytes_ -= taken;
  is_waiting_ = is_waiting_ && waiting_at_ >= taken;
  waiting_at_ -= is_waiting_ ? taken : 0;
}

bool FrameAssembler::has_frame(uint16_t topic_id, size_t count) const {
  size_t at = started_bytes_;
  while (at < least(count, size_bytes_)) {
    const Piece piece = piece_at(at);
    const bool is_frame = piece.is_frame && piece.is_whole;
    if (is_frame && (bytes_[at + 5] | bytes_[at + 6] << 8) == topic_id) return true;
    at += piece.bytes;
  }
  return false;
}

bool FrameAssembler::ends_with_frame() const {
  bool is_frame = false;
  for (size_t at = started_bytes_; is_aligned_ && at < size_bytes_;) {
    const Piece piece = piece_at(at);
    is_frame = piece.is_frame && piece.is_whole;
    at += piece.bytes;
  }
  return is_frame;
}

size_t FrameAssembler::drop_oldest() {
  if (started_bytes_ == size_bytes_) return 0;
  const size_t count = piece_at(started_bytes_).bytes;
  erase(started_bytes_, count);
  return count;
}

size_t FrameAssembler::forget_incomplete() {
  size_t end = started_bytes_;
  while (end < size_bytes_) {
    const Piece piece = piece_at(end);
    if (!piece.is_whole) break;
    end += piece.bytes;
  }
  const size_t count = size_bytes_ - end;
  erase(end, count);
  return count;
}

size_t FrameAssembler::forget_unstarted() {
  const size_t count = size_bytes_ - started_bytes_;
  erase(started_bytes_, count);
  return count;
}

void FrameAssembler::erase(size_t at, size_t count) {
  memmove(bytes_ + at, bytes_ + at + count, size_bytes_ - at - count);
  size_bytes_ -= count;
  is_waiting_ = false;
}

// True while the present bytes agree with a header: five bytes, or fewer at the end.
bool FrameAssembler::could_start_frame(size_t at) const {
  const uint8_t* header = bytes_ + at;
  const size_t count = size_bytes_ - at;
  if (header[0] != kSync) return false;
  if (count > 1 && header[1] != kVersion) return false;
  if (count < kHeaderBytes) return true;
  const uint8_t sum = static_cast<uint8_t>(header[2] + header[3] + header[4]);
  return sum == 0xff && claimed_bytes(at) <= kFrameBytesMax;
}

size_t FrameAssembler::claimed_bytes(size_t at) const {
  return kOverheadBytes + bytes_[at + 2] + (static_cast<size_t>(bytes_[at + 3]) << 8);
}

bool FrameAssembler::has_good_checksum(size_t at, size_t frame_bytes) const {
  uint8_t sum = 0;
  for (size_t i = kHeaderBytes; i < frame_bytes; ++i) sum = static_cast<uint8_t>(sum + bytes_[at + i]);
  return sum == 0xff;
}

FrameAssembler::Piece FrameAssembler::piece_at(size_t at) const {
  const size_t count = size_bytes_ - at;
  if (could_start_frame(at)) {
    if (count < kHeaderBytes) return Piece{count, true, false};
    const size_t frame_bytes = claimed_bytes(at);
    if (count < frame_bytes) return Piece{count, true, false};
    if (has_good_checksum(at, frame_bytes)) return Piece{frame_bytes, true, true};
  }
  size_t end = at + 1;
  while (end < size_bytes_ && !could_start_frame(end)) ++end;
  return Piece{end - at, false, end < size_bytes_ || end - at >= kNoiseBytes};
}

}  // namespace hostlink
