#include "key_proof.h"

#include <string.h>

namespace hostlink {

const size_t KeyProof::kMagicBytes;
const size_t KeyProof::kRandomBytes;
const size_t KeyProof::kQuestionBytes;
const size_t KeyProof::kAnswerBytes;

namespace {
const uint8_t kMagic[KeyProof::kMagicBytes] = {'H', 'L', 'K', '1'};
}  // namespace

void KeyProof::set_key(const char* key, uint32_t (*random)()) {
  key_ = key;
  key_bytes_ = strlen(key);
  random_ = random;
}

void KeyProof::begin() {
  state_ = State::kAsked;
  heard_bytes_ = 0;
  said_bytes_ = 0;
}

size_t KeyProof::wanted_bytes() const {
  if (state_ == State::kAsked) return kQuestionBytes - heard_bytes_;
  if (state_ == State::kAnswered) return Sha256::kDigestBytes - heard_bytes_;
  return 0;
}

void KeyProof::take(const uint8_t* bytes, size_t count) {
  for (size_t i = 0; i < count && wanted_bytes() > 0; ++i) heard_[heard_bytes_++] = bytes[i];
  if (wanted_bytes() > 0) return;
  if (state_ == State::kAsked) {
    answer();
  } else if (state_ == State::kAnswered) {
    uint8_t right[Sha256::kDigestBytes];
    sign("host", right);
    state_ = are_equal(heard_, right, sizeof right) ? State::kProven : State::kRefused;
  }
}

void KeyProof::answer() {
  heard_bytes_ = 0;
  if (memcmp(heard_, kMagic, sizeof kMagic) != 0) {
    state_ = State::kRefused;
    return;
  }
  memcpy(host_random_, heard_ + kMagicBytes, kRandomBytes);
  memcpy(answer_, kMagic, sizeof kMagic);
  for (size_t i = 0; i < kRandomBytes; i += 4) {
    const uint32_t word = random_();
    memcpy(answer_ + kMagicBytes + i, &word, sizeof word);
  }
  sign("device", answer_ + kQuestionBytes);
  state_ = State::kAnswered;
}

void KeyProof::sign(const char* side, uint8_t digest[Sha256::kDigestBytes]) const {
  HmacSha256 hmac(reinterpret_cast<const uint8_t*>(key_), key_bytes_);
  hmac.add(reinterpret_cast<const uint8_t*>(side), strlen(side));
  hmac.add(host_random_, kRandomBytes);
  hmac.add(answer_ + kMagicBytes, kRandomBytes);
  hmac.finish(digest);
}

}  // namespace hostlink
