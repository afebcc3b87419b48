#include "wire.h"

namespace ros {

namespace {

// IEEE 754: sign, exponent with its bias, fraction.
const int kBias32 = 127;
const int kBias64 = 1023;
const int kFraction32Bits = 23;
const int kFraction64Bits = 52;
const int kFractionBitsMore = kFraction64Bits - kFraction32Bits;
const uint32_t kExponent32All = 0xFF;
const int kExponent64All = 0x7FF;
const uint32_t kEmptyElementsMax = 16;  // of messages without fields: the payload does not bound their number

// A double of the board: 8 bytes, or the 4 of a float.
template <size_t size>
struct Double;

template <>
struct Double<8> {
  static uint64_t bits(double value) {
    uint64_t bits = 0;
    memcpy(&bits, &value, sizeof value);
    return bits;
  }
  static double value(uint64_t bits) {
    double value = 0;
    memcpy(&value, &bits, sizeof value);
    return value;
  }
};

template <>
struct Double<4> {
  static uint64_t bits(double value) { return float64_bits_of_float(static_cast<float>(value)); }
  static double value(uint64_t bits) { return static_cast<double>(float_of_float64_bits(bits)); }
};

}  // namespace

uint64_t float64_bits(double value) { return Double<sizeof(double)>::bits(value); }

double float64_value(uint64_t bits) { return Double<sizeof(double)>::value(bits); }

uint64_t float64_bits_of_float(float value) {
  uint32_t in = 0;
  memcpy(&in, &value, sizeof in);
  const uint64_t sign = static_cast<uint64_t>(in >> 31) << 63;
  const uint32_t exponent = in >> kFraction32Bits & kExponent32All;
  if (exponent == 0) return sign;  // zero, and what is too small for a normal float
  const uint64_t fraction = in & ((static_cast<uint32_t>(1) << kFraction32Bits) - 1);
  const int wide = exponent == kExponent32All ? kExponent64All : static_cast<int>(exponent) - kBias32 + kBias64;
  return sign | static_cast<uint64_t>(wide) << kFraction64Bits | fraction << kFractionBitsMore;
}

float float_of_float64_bits(uint64_t bits) {
  const int exponent = static_cast<int>(bits >> kFraction64Bits) & kExponent64All;
  const uint64_t fraction = bits & ((static_cast<uint64_t>(1) << kFraction64Bits) - 1);
  const int narrow = exponent - kBias64 + kBias32;
  uint32_t out = 0;  // too small
  if (exponent == kExponent64All) {
    out = kExponent32All << kFraction32Bits | (fraction != 0 ? static_cast<uint32_t>(1) << (kFraction32Bits - 1) : 0);
  } else if (narrow >= static_cast<int>(kExponent32All)) {
    out = kExponent32All << kFraction32Bits;
  } else if (narrow > 0) {
    const uint64_t half = static_cast<uint64_t>(1) << (kFractionBitsMore - 1);
    out = static_cast<uint32_t>(narrow) << kFraction32Bits | static_cast<uint32_t>(fraction >> kFractionBitsMore);
    const uint64_t rest = fraction & (2 * half - 1);
    if (rest > half || (rest == half && (out & 1) != 0)) ++out;  // may carry into the exponent, up to infinity
  }
  out |= static_cast<uint32_t>(bits >> 63) << 31;
  float value = 0;
  memcpy(&value, &out, sizeof value);
  return value;
}

uint8_t* Writer::claim(size_t size) {
  size_ = size < SIZE_MAX - size_ ? size_ + size : SIZE_MAX;
  is_good_ = is_good_ && size_ <= room_;
  return is_good_ ? bytes_ + (size_ - size) : nullptr;
}

void Writer::put_number(uint32_t value, size_t size) {
  uint8_t* bytes = claim(size);
  if (bytes == nullptr) return;
  for (size_t i = 0; i < size; ++i, value >>= 8) bytes[i] = static_cast<uint8_t>(value);
}

void Writer::put_long(uint64_t value) {
  uint8_t* bytes = claim(8);
  if (bytes == nullptr) return;
  for (size_t i = 0; i < 8; ++i, value >>= 8) bytes[i] = static_cast<uint8_t>(value);
}

void Writer::put(float value) {
  uint32_t bits = 0;
  memcpy(&bits, &value, sizeof bits);
  put_number(bits, 4);
}

void Writer::put(const char* text) {
  const size_t length = text == nullptr ? 0 : strlen(text);
  put(static_cast<uint32_t>(length));
  uint8_t* bytes = claim(length);
  if (bytes != nullptr && length > 0) memcpy(bytes, text, length);  // NOLINT(bugprone-not-null-terminated-result)
}

uint8_t* Reader::claim(size_t size) {
  if (!is_good_ || size > left_) {
    is_good_ = false;
    return nullptr;
  }
  left_ -= size;
  bytes_ += size;
  return bytes_ - size;
}

uint32_t Reader::get_number(size_t size) {
  const uint8_t* bytes = claim(size);
  uint32_t value = 0;
  for (size_t i = size; bytes != nullptr && i > 0; --i) value = value << 8 | bytes[i - 1];
  return value;
}

uint64_t Reader::get_long() {
  const uint64_t low = get_number(4);
  return low | static_cast<uint64_t>(get_number(4)) << 32;
}

void Reader::get(float& value) {
  const uint32_t bits = get_number(4);
  memcpy(&value, &bits, sizeof value);
}

void Reader::get(const char*& text) {
  const uint32_t length = get_count(1);
  uint8_t* bytes = claim(static_cast<size_t>(length));
  text = "";
  if (bytes == nullptr) return;
  memmove(bytes - 1, bytes, static_cast<size_t>(length));  // over the last byte of its length
  *(bytes + length - 1) = 0;                               // without characters: over that byte itself
  text = reinterpret_cast<const char*>(bytes - 1);
}

void Reader::get_variable(uint8_t*& values, uint32_t& count, size_t least) {
  count = get_count(least);
  values = claim(static_cast<size_t>(count));
  if (values == nullptr) count = 0;
}

// The number of elements of an array, or of bytes of a text; 0 if the payload is too short for them.
uint32_t Reader::get_count(size_t least) {
  const uint32_t count = get_number(4);
  const uint32_t most = least == 0 ? kEmptyElementsMax : static_cast<uint32_t>(left_ / least);
  if (count > most) is_good_ = false;
  return is_good_ ? count : 0;
}

void* Reader::allocate(uint32_t count, size_t size, size_t alignment) {
  const size_t beyond = reinterpret_cast<uintptr_t>(storage_) % alignment;
  const size_t padding = beyond == 0 ? 0 : alignment - beyond;
  if (!is_good_ || padding > storage_left_ || count > (storage_left_ - padding) / size) {
    is_good_ = is_good_ && count == 0;
    return nullptr;
  }
  storage_left_ -= padding + static_cast<size_t>(count) * size;
  storage_ += padding + static_cast<size_t>(count) * size;
  return storage_ - static_cast<size_t>(count) * size;
}

}  // namespace ros
