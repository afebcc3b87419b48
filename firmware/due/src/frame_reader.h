// Finds the frames of rosserial protocol 2 in the bytes from the host. Knows no clock, no topic and no UART.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace hostlink {

const size_t kPayloadBytesMax = 512;
const size_t kOverheadBytes = 8;

// Which frames the device accepts: a false start often shows by its id or its size, long before its checksum.
class Expected {
 public:
  virtual bool is_expected(uint16_t topic_id, size_t payload_bytes) const = 0;

 protected:
  ~Expected() {}
};

class FrameReader {
 public:
  enum Result { kNothing, kFrame, kWrongVersion };

  // `rescans`: after a false start the bytes that came since are read again, so that a good frame among them is not
  // lost, and a frame that nobody expects is a false start. Without, they are gone, as in the original library.
  FrameReader(bool rescans, const Expected& expected) : rescans_(rescans), expected_(expected) {}

  // Adds one byte. kFrame: topic_id(), payload() and payload_bytes() are valid until the next call.
  Result add(uint8_t byte);
  // A frame is among the bytes that were read again: call until kNothing, before the next add().
  Result again();

  bool is_inside() const { return size_ > 0; }
  void give_up();  // the frame that is waited for does not come

  uint16_t topic_id() const { return static_cast<uint16_t>(bytes_[5] | bytes_[6] << 8); }
  const uint8_t* payload() const { return bytes_ + 7; }
  size_t payload_bytes() const { return frame_bytes_ - kOverheadBytes; }

  uint32_t dropped() const { return dropped_; }  // starts that were no frames

 private:
  Result judge();
  size_t claimed_bytes() const { return static_cast<size_t>(bytes_[2] | bytes_[3] << 8); }
  bool is_false_start() const;
  void fail();
  void drop(size_t count);

  bool rescans_;
  const Expected& expected_;
  uint8_t bytes_[kPayloadBytesMax + kOverheadBytes] = {};
  size_t size_ = 0;
  size_t frame_bytes_ = 0;  // of the frame that was found; it is dropped by the next call
  uint32_t dropped_ = 0;
};

}  // namespace hostlink
