#include "text.h"

namespace hostlink {

Text& Text::add(const char* text) {
  while (*text != '\0') add_char(*text++);
  return *this;
}

Text& Text::add(int32_t number) {
  if (number < 0) add_char('-');
  return add_digits(number < 0 ? 0u - static_cast<uint32_t>(number) : static_cast<uint32_t>(number), 1);
}

Text& Text::add(uint32_t number) { return add_digits(number, 1); }

Text& Text::add(float number, uint8_t decimals) {
  uint32_t scale = 1;
  for (uint8_t i = 0; i < decimals; ++i) scale *= 10;
  const float size = number < 0.0f ? -number : number;
  const float scaled = size * static_cast<float>(scale) + 0.5f;
  if (!(scaled < 2147483648.0f)) return add_char('?');
  const uint32_t digits = static_cast<uint32_t>(scaled);
  if (number < 0.0f && digits > 0) add_char('-');
  add_digits(digits / scale, 1);
  if (decimals == 0) return *this;
  return add_char('.').add_digits(digits % scale, decimals);
}

Text& Text::add_char(char c) {
  if (size_ < kMost) chars_[size_++] = c;
  return *this;
}

Text& Text::add_digits(uint32_t number, uint8_t least) {
  char digits[10];
  uint8_t count = 0;
  while (number > 0 || count < least) {
    digits[count++] = static_cast<char>('0' + number % 10);
    number /= 10;
  }
  while (count > 0) add_char(digits[--count]);
  return *this;
}

}  // namespace hostlink
