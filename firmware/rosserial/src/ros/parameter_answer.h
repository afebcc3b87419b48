// The host's answer to a request for a parameter: whole numbers, floats, or texts; empty if the host has none.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace ros {

class ParameterAnswer {
 public:
  // False: the payload is not an answer.
  bool read(uint8_t* payload, size_t size);

  bool is_empty() const { return ints_count_ == 0 && floats_count_ == 0 && texts_count_ == 0; }
  // The number of values. At most `most` are copied.
  size_t numbers(float* values, size_t most) const;  // floats, otherwise whole numbers
  size_t ints(int32_t* values, size_t most) const;
  size_t floats(float* values, size_t most) const;
  size_t texts() const { return texts_count_; }
  // Copies all values if they have this type and number; otherwise changes nothing. A bool is a whole number.
  bool copy(int* values, size_t count) const;
  bool copy(float* values, size_t count) const;
  bool copy(bool* values, size_t count) const;
  bool copy(char* chars, size_t room) const { return text(0, chars, room); }
  // Copies the text with its zero. False: there is no text of this number, or it does not fit.
  bool text(size_t number, char* chars, size_t room) const;

 private:
  int32_t whole_number(size_t number) const;

  const uint8_t* ints_ = nullptr;
  const uint8_t* floats_ = nullptr;
  const uint8_t* texts_ = nullptr;
  const uint8_t* end_ = nullptr;
  size_t ints_count_ = 0;
  size_t floats_count_ = 0;
  size_t texts_count_ = 0;
};

}  // namespace ros
