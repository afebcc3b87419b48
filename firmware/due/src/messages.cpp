#include "messages.h"

#include <string.h>

namespace hostlink {

namespace {

// IEEE 754: sign, exponent with its bias, fraction.
const int kBias32 = 127;
const int kBias64 = 1023;
const int kFraction32Bits = 23;
const int kFraction64Bits = 52;
const uint32_t kExponent32All = 0xFF;
const uint64_t kExponent64All = 0x7FF;

}  // namespace

float read_float64(const uint8_t* bytes) {
  uint64_t bits = 0;
  for (int i = 0; i < 8; ++i) bits |= static_cast<uint64_t>(bytes[i]) << (8 * i);
  const uint32_t sign = static_cast<uint32_t>(bits >> 63) << 31;
  const int exponent = static_cast<int>(bits >> kFraction64Bits & kExponent64All);
  const uint64_t fraction = bits & ((static_cast<uint64_t>(1) << kFraction64Bits) - 1);
  uint32_t out = sign;  // zero, and values that are too small
  if (exponent == static_cast<int>(kExponent64All)) {
    out |= kExponent32All << kFraction32Bits | (fraction != 0 ? 1u : 0u);
  } else if (exponent - kBias64 > kBias32) {
    out |= kExponent32All << kFraction32Bits;
  } else if (exponent - kBias64 > -kBias32) {
    out |= static_cast<uint32_t>(exponent - kBias64 + kBias32) << kFraction32Bits;
    out |= static_cast<uint32_t>(fraction >> (kFraction64Bits - kFraction32Bits));
  }
  float value = 0.0f;
  memcpy(&value, &out, sizeof value);
  return value;
}

void write_float64(uint8_t* bytes, float value) {
  uint32_t in = 0;
  memcpy(&in, &value, sizeof in);
  const uint32_t exponent = in >> kFraction32Bits & kExponent32All;
  uint64_t bits = static_cast<uint64_t>(in >> 31) << 63;
  if (exponent == kExponent32All) {
    bits |= kExponent64All << kFraction64Bits;
  } else if (exponent != 0) {
    bits |= static_cast<uint64_t>(static_cast<int>(exponent) - kBias32 + kBias64) << kFraction64Bits;
  }
  if (exponent != 0) {  // a value that is too small for a normal float becomes zero
    const uint64_t fraction = in & ((static_cast<uint32_t>(1) << kFraction32Bits) - 1);
    bits |= fraction << (kFraction64Bits - kFraction32Bits);
  }
  for (int i = 0; i < 8; ++i) bytes[i] = static_cast<uint8_t>(bits >> (8 * i));
}

void write_float32(uint8_t* bytes, float value) {
  uint32_t bits = 0;
  memcpy(&bits, &value, sizeof bits);
  for (int i = 0; i < 4; ++i) bytes[i] = static_cast<uint8_t>(bits >> (8 * i));
}

}  // namespace hostlink
