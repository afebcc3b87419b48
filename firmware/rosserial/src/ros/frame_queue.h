// Whole frames that wait for the line to the host. When there is no room, the oldest messages of topics are dropped,
// because newer ones replace them. Lines of the log are dropped only for frames that the host waits for: topics,
// requests, and the halves of services, which are never dropped.
#pragma once

#include "link.h"
#include "topics.h"
#include "wire.h"

namespace ros {

const uint16_t kFirstTopicId = 100;
const uint16_t kIdLog = 7;

class FrameQueue {
 public:
  static const size_t kHeaderBytes = 7;
  static const size_t kOverheadBytes = 8;

  FrameQueue(uint8_t* bytes, size_t capacity, size_t payload_bytes_max, const Topics& topics)
      : bytes_(bytes), capacity_(capacity), payload_bytes_max_(payload_bytes_max), topics_(topics) {}

  // Place of the next frame's payload; valid until the next call.
  Writer open();
  bool has_room(size_t payload_bytes) const {
    return payload_bytes <= payload_bytes_max_ && payload_bytes + kOverheadBytes <= capacity_ - size_;
  }
  // Drop frames of a lower rank until a frame of this id fits. False: it does not fit even then; nothing was dropped.
  bool make_room(uint16_t id, size_t payload_bytes);
  // End the frame whose payload was written.
  void close(uint16_t id, size_t payload_bytes);
  bool flush(Link& link);  // whether some frames are left
  void clear();

  size_t payload_bytes_max() const { return payload_bytes_max_; }
  uint32_t dropped() const { return dropped_; }  // messages
  uint32_t dropped_lines() const { return dropped_lines_; }

 private:
  // A lower rank is dropped for a higher one, and a message for the next one.
  enum class Rank : uint8_t { kMessage, kLine, kAwaited };

  Rank rank(uint16_t id) const;
  uint16_t frame_id(size_t at) const { return static_cast<uint16_t>(bytes_[at + 5] | bytes_[at + 6] << 8); }
  size_t frame_bytes(size_t at) const;
  bool drop_oldest(Rank of_rank);
  void leave(size_t count);

  uint8_t* bytes_;
  size_t capacity_;
  size_t payload_bytes_max_;
  const Topics& topics_;
  size_t head_ = 0;         // of the bytes before it, which were sent
  size_t size_ = 0;         // after the head
  size_t begun_bytes_ = 0;  // of the first frame, which was sent in part: the size of its rest
  uint32_t dropped_ = 0;
  uint32_t dropped_lines_ = 0;
};

}  // namespace ros
