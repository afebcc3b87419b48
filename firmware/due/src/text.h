// A line for the host's log, composed without printf, which would add 10 KB and the heap.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace hostlink {

class Text {
 public:
  static const size_t kMost = 120;  // a longer text is cut

  Text& add(const char* text);
  Text& add(int32_t number);
  Text& add(uint32_t number);
  // With `decimals` digits after the point; a value that does not fit an int32 is "?".
  Text& add(float number, uint8_t decimals);

  const char* chars() const { return chars_; }

 private:
  Text& add_char(char c);
  Text& add_digits(uint32_t number, uint8_t least);

  char chars_[kMost + 1] = {};
  size_t size_ = 0;
};

}  // namespace hostlink
