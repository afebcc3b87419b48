// Cuts a byte stream into pieces that one write may send: whole rosserial frames, or bytes that are not frames.
// Owns the bytes between two ports: no clock, no port. The order is kept, and no byte is lost or added, except those
// that restart(), drop_oldest() and the forget_ functions drop and count.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace hostlink {

// How long bytes wait for the rest of their frame.
struct Hold {
  uint32_t quiet_ms;    // since the last byte came
  uint32_t longest_ms;  // since the frame began, even if bytes still arrive slowly
};

class FrameAssembler {
 public:
  static const size_t kOverheadBytes = 8;
  static const size_t kPayloadBytesMax = 1024;  // a header that claims more is not a header
  static const size_t kFrameBytesMax = kPayloadBytesMax + kOverheadBytes;
  static const size_t kCapacityBytes = 2 * kFrameBytesMax;  // so a full buffer always has a whole piece

  explicit FrameAssembler(const Hold& hold) : hold_(hold) {}

  // Forget everything, then drop incoming bytes up to the first frame header or a quiet period, whichever is first.
  void restart(uint32_t now_ms);

  // Adds as many bytes as there is room for; returns how many.
  size_t put(const uint8_t* bytes, size_t count, uint32_t now_ms);
  size_t room_bytes() const { return kCapacityBytes - size_bytes_; }
  size_t size_bytes() const { return size_bytes_; }

  // How many bytes from head() one write of at most limit_bytes may send now. Frames are not cut.
  size_t ready_bytes(size_t limit_bytes, uint32_t now_ms);
  const uint8_t* head() const { return bytes_; }
  // The first count bytes were sent. If they end inside a frame, its rest is ready at once.
  void take(size_t count);

  // Whether a frame with this id begins within the first count bytes that are ready.
  bool has_frame(uint16_t topic_id, size_t count) const;

  // Whether the last received bytes are a whole frame, so that a new frame may begin here.
  bool ends_with_frame() const;

  // Each function forgets bytes and returns how many. A piece that was partly sent is never forgotten.
  size_t drop_oldest();        // the oldest piece
  size_t forget_incomplete();  // the incomplete frame at the end
  size_t forget_unstarted();   // all

  uint32_t swallowed_bytes() const { return swallowed_bytes_; }  // by restart(), since the start

 private:
  struct Piece {
    size_t bytes;
    bool is_frame;
    bool is_whole;
  };

  bool could_start_frame(size_t at) const;
  size_t claimed_bytes(size_t at) const;
  bool has_good_checksum(size_t at, size_t frame_bytes) const;
  Piece piece_at(size_t at) const;
  bool has_waited_enough(size_t at, uint32_t now_ms);
  void align();
  void erase(size_t at, size_t count);

  const Hold hold_;
  uint8_t bytes_[kCapacityBytes] = {};
  size_t size_bytes_ = 0;
  size_t started_bytes_ = 0;  // rest of a frame whose first part was sent
  size_t waiting_at_ = 0;     // where the incomplete piece begins
  uint32_t waiting_since_ms_ = 0;
  bool is_waiting_ = false;
  bool is_aligned_ = true;
  uint32_t last_put_ms_ = 0;
  size_t unaligned_bytes_ = 0;  // dropped since restart()
  uint32_t swallowed_bytes_ = 0;
};

}  // namespace hostlink
