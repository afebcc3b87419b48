// The device's side of the proof that device and host share a key (hostlink/core/transport/keyed.py):
//   host -> device   "HLK1", 16 random bytes
//   device -> host   "HLK1", 16 random bytes, HMAC-SHA256(key, "device", both randoms)
//   host -> device   HMAC-SHA256(key, "host", both randoms)
// Owns the bytes of both sides, and no port.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "../ros/link.h"
#include "sha256.h"

namespace hostlink {

/*
  state     event                        next
  asked     the host's 20 bytes came     answered; without "HLK1": refused
  answered  the host's 32 bytes came     proven if they are right, else refused
*/
class KeyProof {
 public:
  enum class State : uint8_t { kAsked, kAnswered, kProven, kRefused };
  static const size_t kMagicBytes = 4;
  static const size_t kRandomBytes = 16;
  static const size_t kQuestionBytes = kMagicBytes + kRandomBytes;
  static const size_t kAnswerBytes = kQuestionBytes + Sha256::kDigestBytes;

  // The key must stay valid. Empty: no proof is required.
  void set_key(const char* key, uint32_t (*random)());
  bool has_key() const { return key_bytes_ > 0; }

  void begin();  // a new connection
  // How many bytes of the host belong to its proof; the bytes after them are rosserial.
  size_t wanted_bytes() const;
  void take(const uint8_t* bytes, size_t count);
  // Bytes for the host.
  const uint8_t* to_say() const { return answer_ + said_bytes_; }
  size_t to_say_bytes() const { return state_ == State::kAnswered ? kAnswerBytes - said_bytes_ : 0; }
  void said(size_t count) { said_bytes_ += ros::accepted_of(to_say_bytes(), count); }
  State state() const { return state_; }

 private:
  void answer();
  void sign(const char* side, uint8_t digest[Sha256::kDigestBytes]) const;

  const char* key_ = "";
  size_t key_bytes_ = 0;
  uint32_t (*random_)() = nullptr;
  State state_ = State::kAsked;
  uint8_t heard_[Sha256::kDigestBytes] = {};
  size_t heard_bytes_ = 0;
  uint8_t host_random_[kRandomBytes] = {};
  uint8_t answer_[kAnswerBytes] = {};
  size_t said_bytes_ = 0;
};

}  // namespace hostlink
