// SHA-256 (FIPS 180-4) and HMAC with it (RFC 2104), in 112 bytes of state and without a heap.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace hostlink {

class Sha256 {
 public:
  static const size_t kDigestBytes = 32;
  static const size_t kBlockBytes = 64;

  void add(const uint8_t* bytes, size_t count);
  // Ends the message; the object cannot be used again.
  void finish(uint8_t digest[kDigestBytes]);

 private:
  void mix_block();

  uint32_t state_[8] = {0x6a09e667u, 0xbb67ae85u, 0x3c6ef372u, 0xa54ff53au,
                        0x510e527fu, 0x9b05688cu, 0x1f83d9abu, 0x5be0cd19u};
  uint8_t block_[kBlockBytes] = {};
  size_t block_bytes_ = 0;
  uint64_t message_bytes_ = 0;
};

class HmacSha256 {
 public:
  HmacSha256(const uint8_t* key, size_t key_bytes);
  void add(const uint8_t* bytes, size_t count) { inner_.add(bytes, count); }
  void finish(uint8_t digest[Sha256::kDigestBytes]);

 private:
  uint8_t pad_[Sha256::kBlockBytes] = {};
  Sha256 inner_;
};

// The duration does not depend on the position of a difference, so it reveals nothing.
bool are_equal(const uint8_t* a, const uint8_t* b, size_t count);

}  // namespace hostlink
