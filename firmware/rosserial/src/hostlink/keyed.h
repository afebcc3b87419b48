// A connection whose two ends prove to each other that they know the same key (tcp.key_file of hostlink), before the
// first byte of rosserial. `Hardware` returns kRestarted at each connection and has close(), like
// ClientHardware.
#pragma once

#include "../ros/link.h"
#include "key_proof.h"

namespace hostlink {

template <class Hardware>
class Keyed : public Hardware {
 public:
  // The key must stay valid; empty: no proof is required. `random` gives 32 unpredictable bits.
  void setKey(const char* key, uint32_t (*random)()) { proof_.set_key(key, random); }
  bool is_proven() const { return !proof_.has_key() || proof_.state() == KeyProof::State::kProven; }

  int read() override {
    for (;;) {
      const int byte = Hardware::read();
      if (byte == ros::Link::kRestarted) {
        proof_.begin();
        began_ms_ = this->milliseconds();
        return byte;
      }
      if (is_proven()) return byte;
      if (byte >= 0) {
        const uint8_t heard = static_cast<uint8_t>(byte);
        proof_.take(&heard, 1);
      }
      answer();
      if (byte < 0) return byte;
    }
  }

  size_t write(const uint8_t* bytes, size_t size) override { return is_proven() ? Hardware::write(bytes, size) : 0; }

 private:
  static const uint32_t kProofMs = 4000;

  void answer() {
    if (proof_.to_say_bytes() > 0) proof_.said(Hardware::write(proof_.to_say(), proof_.to_say_bytes()));
    const bool is_refused = proof_.state() == KeyProof::State::kRefused;
    if (is_refused || (Hardware::is_connected() && this->milliseconds() - began_ms_ > kProofMs)) Hardware::close();
  }

  KeyProof proof_;
  uint32_t began_ms_ = 0;
};

}  // namespace hostlink
