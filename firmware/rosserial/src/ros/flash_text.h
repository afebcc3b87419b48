// Texts that stay in the flash: on an AVR every other constant text is also in the RAM.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__AVR__)
#include <avr/pgmspace.h>
#define ROS_IN_FLASH PROGMEM
#else
#define ROS_IN_FLASH
#endif

namespace ros {

// A text of `static const char text[] ROS_IN_FLASH`. Its address identifies it.
class FlashText {
 public:
  explicit constexpr FlashText(const char* address) : address_(address) {}

#if defined(__AVR__)
  size_t size() const { return strlen_P(address_); }
  char operator[](size_t at) const { return static_cast<char>(pgm_read_byte(address_ + at)); }
#else
  size_t size() const { return strlen(address_); }
  char operator[](size_t at) const { return address_[at]; }
  operator const char*() const { return address_; }
#endif
  const char* address() const { return address_; }

 private:
  const char* address_;
};

// Size of a message on the wire in bytes; 65535 for a message without a fixed size.
class Size {
 public:
  constexpr Size(uint32_t minimum, uint32_t maximum) : minimum_(clamp(minimum)), maximum_(clamp(maximum)) {}
  static constexpr Size exactly(uint32_t bytes) { return Size(bytes, bytes); }

  constexpr bool has(size_t bytes) const { return bytes >= minimum_ && bytes <= maximum_; }
  constexpr bool is_fixed() const { return minimum_ == maximum_; }
  constexpr uint16_t minimum() const { return minimum_; }

 private:
  static constexpr uint16_t clamp(uint32_t bytes) {
    return bytes < UINT16_MAX ? static_cast<uint16_t>(bytes) : static_cast<uint16_t>(UINT16_MAX);
  }

  uint16_t minimum_;
  uint16_t maximum_;
};

}  // namespace ros
