// Finds the frames of rosserial protocol 2 in the bytes from the host. Has no clock, topic or UART.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "topics.h"

namespace ros {

const size_t kOverheadBytes = 8;

class FrameReader {
 public:
  enum Result { kNothing, kFrame, kWrongVersion };

  // `rescans`: after a false start the later bytes are read again, so that a good frame among them is not lost, and a
  // frame with an unexpected id is a false start. Without it they are dropped, like in the original library.
  // The buffer belongs to the reader: a payload may be as large as the buffer, less kOverheadBytes.
  FrameReader(uint8_t* bytes, size_t capacity, bool rescans, const Topics& topics)
      : bytes_(bytes), capacity_(capacity), rescans_(rescans), topics_(topics) {}

  // Adds one byte. kFrame: topic_id(), payload() and payload_bytes() are valid until the next call.
  Result add(uint8_t byte);
  // A frame is among the bytes that are read again: call until kNothing, before the next add().
  Result again();

  bool is_inside() const { return size_ > 0; }
  void give_up();  // give up the incomplete frame
  void clear();    // forget everything: the next byte is from another connection
  bool has_frame() const { return frame_bytes_ > 0; }
  size_t payload_bytes_max() const { return capacity_ - kOverheadBytes; }

  uint16_t topic_id() const { return static_cast<uint16_t>(bytes_[5] | bytes_[6] << 8); }
  uint8_t* payload() { return bytes_ + 7; }  // the caller may write to it
  size_t payload_bytes() const { return frame_bytes_ - kOverheadBytes; }

  uint32_t dropped() const { return dropped_; }  // false starts

 private:
  Result judge();
  size_t claimed_bytes() const { return static_cast<size_t>(bytes_[2] | bytes_[3] << 8); }
  bool is_false_start() const;
  void fail();
  void drop(size_t count);

  uint8_t* bytes_;
  size_t capacity_;
  bool rescans_;
  const Topics& topics_;
  size_t size_ = 0;
  size_t frame_bytes_ = 0;  // size of the frame that was found; the next call drops it
  uint32_t dropped_ = 0;
};

}  // namespace ros
