#include "sha256.h"

namespace hostlink {

const size_t Sha256::kDigestBytes;
const size_t Sha256::kBlockBytes;

namespace {
const uint32_t kRound[64] = {
    0x428a2f98u, 0x71374491u, 0xb5c0fbcfu, 0xe9b5dba5u, 0x3956c25bu, 0x59f111f1u, 0x923f82a4u, 0xab1c5ed5u,
    0xd807aa98u, 0x12835b01u, 0x243185beu, 0x550c7dc3u, 0x72be5d74u, 0x80deb1feu, 0x9bdc06a7u, 0xc19bf174u,
    0xe49b69c1u, 0xefbe4786u, 0x0fc19dc6u, 0x240ca1ccu, 0x2de92c6fu, 0x4a7484aau, 0x5cb0a9dcu, 0x76f988dau,
    0x983e5152u, 0xa831c66du, 0xb00327c8u, 0xbf597fc7u, 0xc6e00bf3u, 0xd5a79147u, 0x06ca6351u, 0x14292967u,
    0x27b70a85u, 0x2e1b2138u, 0x4d2c6dfcu, 0x53380d13u, 0x650a7354u, 0x766a0abbu, 0x81c2c92eu, 0x92722c85u,
    0xa2bfe8a1u, 0xa81a664bu, 0xc24b8b70u, 0xc76c51a3u, 0xd192e819u, 0xd6990624u, 0xf40e3585u, 0x106aa070u,
    0x19a4c116u, 0x1e376c08u, 0x2748774cu, 0x34b0bcb5u, 0x391c0cb3u, 0x4ed8aa4au, 0x5b9cca4fu, 0x682e6ff3u,
    0x748f82eeu, 0x78a5636fu, 0x84c87814u, 0x8cc70208u, 0x90befffau, 0xa4506cebu, 0xbef9a3f7u, 0xc67178f2u};
const uint8_t kInnerPad = 0x36, kOuterPad = 0x5c;

uint32_t rotated(uint32_t word, unsigned bits) { return (word >> bits) | (word << (32 - bits)); }

uint32_t read_word(const uint8_t* bytes) {
  return static_cast<uint32_t>(bytes[0]) << 24 | static_cast<uint32_t>(bytes[1]) << 16 |
         static_cast<uint32_t>(bytes[2]) << 8 | bytes[3];
}

// The next word of the message schedule replaces the one sixteen before it.
uint32_t next_word(uint32_t schedule[16], size_t round) {
  const uint32_t w1 = schedule[(round + 1) % 16], w14 = schedule[(round + 14) % 16];
  const uint32_t small0 = rotated(w1, 7) ^ rotated(w1, 18) ^ (w1 >> 3);
  const uint32_t small1 = rotated(w14, 17) ^ rotated(w14, 19) ^ (w14 >> 10);
  return schedule[round % 16] += small0 + schedule[(round + 9) % 16] + small1;
}
}  // namespace

void Sha256::add(const uint8_t* bytes, size_t count) {
  message_bytes_ += count;
  for (size_t i = 0; i < count; ++i) {
    block_[block_bytes_++] = bytes[i];
    if (block_bytes_ == kBlockBytes) mix_block();
  }
}

void Sha256::finish(uint8_t digest[kDigestBytes]) {
  const uint64_t message_bits = message_bytes_ * 8;
  const uint8_t end = 0x80, zero = 0;
  add(&end, 1);
  while (block_bytes_ != kBlockBytes - 8) add(&zero, 1);
  for (unsigned i = 0; i < 8; ++i) {
    const uint8_t length = static_cast<uint8_t>(message_bits >> (56 - 8 * i));
    add(&length, 1);
  }
  for (size_t i = 0; i < kDigestBytes; ++i) digest[i] = static_cast<uint8_t>(state_[i / 4] >> (24 - 8 * (i % 4)));
}

void Sha256::mix_block() {
  uint32_t schedule[16];
  for (size_t i = 0; i < 16; ++i) schedule[i] = read_word(block_ + 4 * i);
  uint32_t s[8];
  for (size_t i = 0; i < 8; ++i) s[i] = state_[i];
  for (size_t round = 0; round < 64; ++round) {
    const uint32_t word = round < 16 ? schedule[round] : next_word(schedule, round);
    const uint32_t big1 = rotated(s[4], 6) ^ rotated(s[4], 11) ^ rotated(s[4], 25);
    const uint32_t chosen = (s[4] & s[5]) ^ (~s[4] & s[6]);
    const uint32_t first = s[7] + big1 + chosen + kRound[round] + word;
    const uint32_t big0 = rotated(s[0], 2) ^ rotated(s[0], 13) ^ rotated(s[0], 22);
    const uint32_t majority = (s[0] & s[1]) ^ (s[0] & s[2]) ^ (s[1] & s[2]);
    for (size_t i = 7; i > 0; --i) s[i] = s[i - 1];
    s[4] += first;
    s[0] = first + big0 + majority;
  }
  for (size_t i = 0; i < 8; ++i) state_[i] += s[i];
  block_bytes_ = 0;
}

HmacSha256::HmacSha256(const uint8_t* key, size_t key_bytes) {
  if (key_bytes > Sha256::kBlockBytes) {
    Sha256 shortened;
    shortened.add(key, key_bytes);
    shortened.finish(pad_);
  } else {
    for (size_t i = 0; i < key_bytes; ++i) pad_[i] = key[i];
  }
  for (uint8_t& byte : pad_) byte ^= kInnerPad;
  inner_.add(pad_, sizeof pad_);
}

void HmacSha256::finish(uint8_t digest[Sha256::kDigestBytes]) {
  inner_.finish(digest);
  for (uint8_t& byte : pad_) byte ^= kInnerPad ^ kOuterPad;
  Sha256 outer;
  outer.add(pad_, sizeof pad_);
  outer.add(digest, Sha256::kDigestBytes);
  outer.finish(digest);
}

bool are_equal(const uint8_t* a, const uint8_t* b, size_t count) {
  uint8_t difference = 0;
  for (size_t i = 0; i < count; ++i) difference = static_cast<uint8_t>(difference | (a[i] ^ b[i]));
  return difference == 0;
}

}  // namespace hostlink
