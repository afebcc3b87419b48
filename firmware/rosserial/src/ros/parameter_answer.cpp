#include "parameter_answer.h"

#include <string.h>

namespace ros {

namespace {

const size_t kCountBytes = 4;
const size_t kNumberBytes = 4;

uint32_t read_u32(const uint8_t* bytes) {
  return static_cast<uint32_t>(bytes[0]) | static_cast<uint32_t>(bytes[1]) << 8 |
         static_cast<uint32_t>(bytes[2]) << 16 | static_cast<uint32_t>(bytes[3]) << 24;
}

// A list of elements of at least four bytes each; nullptr: its length is wrong, or it is empty.
const uint8_t* read_list(const uint8_t* at, const uint8_t* end, size_t& count) {
  if (at == nullptr || static_cast<size_t>(end - at) < kCountBytes) return nullptr;
  const uint32_t announced = read_u32(at);
  at += kCountBytes;
  if (announced > static_cast<size_t>(end - at) / kNumberBytes) return nullptr;
  count = static_cast<size_t>(announced);
  return at;
}

}  // namespace

bool ParameterAnswer::read(uint8_t* payload, size_t size) {
  end_ = payload + size;
  ints_ = read_list(payload, end_, ints_count_);
  if (ints_ == nullptr) return false;
  floats_ = read_list(ints_ + ints_count_ * kNumberBytes, end_, floats_count_);
  if (floats_ == nullptr) return ints_count_ > 0;
  texts_ = read_list(floats_ + floats_count_ * kNumberBytes, end_, texts_count_);
  return true;
}

size_t ParameterAnswer::numbers(float* values, size_t most) const {
  if (floats_count_ > 0 || ints_count_ == 0) return floats(values, most);
  for (size_t i = 0; i < ints_count_ && i < most; ++i) values[i] = static_cast<float>(whole_number(i));
  return ints_count_;
}

int32_t ParameterAnswer::whole_number(size_t number) const {
  return static_cast<int32_t>(read_u32(ints_ + kNumberBytes * number));
}

bool ParameterAnswer::copy(int* values, size_t count) const {
  if (count == 0 || ints_count_ != count) return false;
  for (size_t i = 0; i < count; ++i) {
    if (static_cast<int>(whole_number(i)) != whole_number(i)) return false;  // an AVR's int has 16 bits
  }
  for (size_t i = 0; i < count; ++i) values[i] = static_cast<int>(whole_number(i));
  return true;
}

bool ParameterAnswer::copy(bool* values, size_t count) const {
  if (count == 0 || ints_count_ != count) return false;
  for (size_t i = 0; i < count; ++i) values[i] = whole_number(i) != 0;
  return true;
}

// Also accept whole numbers: a host that writes 2.0 as 2 means the same.
bool ParameterAnswer::copy(float* values, size_t count) const {
  if (count == 0 || (floats_count_ != count && (floats_count_ > 0 || ints_count_ != count))) return false;
  numbers(values, count);
  return true;
}

size_t ParameterAnswer::ints(int32_t* values, size_t most) const {
  for (size_t i = 0; i < ints_count_ && i < most; ++i) values[i] = whole_number(i);
  return ints_count_;
}

size_t ParameterAnswer::floats(float* values, size_t most) const {
  for (size_t i = 0; i < floats_count_ && i < most; ++i) {
    const uint32_t bits = read_u32(floats_ + kNumberBytes * i);
    memcpy(&values[i], &bits, sizeof bits);
  }
  return floats_count_;
}

bool ParameterAnswer::text(size_t number, char* chars, size_t room) const {
  const uint8_t* at = texts_;
  for (size_t i = 0; number < texts_count_; ++i) {
    if (static_cast<size_t>(end_ - at) < kCountBytes) return false;
    const uint32_t size = read_u32(at);
    at += kCountBytes;
    if (size > static_cast<size_t>(end_ - at)) return false;
    if (i == number) {
      if (size >= room) return false;
      memcpy(chars, at, static_cast<size_t>(size));
      chars[size] = '\0';
      return true;
    }
    at += size;
  }
  return false;
}

}  // namespace ros
