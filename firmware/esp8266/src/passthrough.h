// The bridge between the device's UART and the host's TCP port: decides when to connect, what may pass, and when a link
// is dead. Owns the two buffers and the state; the shell owns the ports and connects on request.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include <hostlink/backoff.h>
#include <hostlink/key_proof.h>

#include "frame_assembler.h"
#include "ports.h"
#include "signal_report.h"

namespace hostlink {

enum class LinkState : uint8_t { kJoining, kWaiting, kProving, kConnected };

enum class LinkEnd : uint8_t { kWifiLost, kPeerClosed, kWriteStalled, kHostSilent, kKeyRefused, kCount };

struct Counters {
  uint32_t from_device_bytes = 0;  // forwarded
  uint32_t to_device_bytes = 0;
  uint32_t from_device_dropped_bytes = 0;    // oldest frames, because the network did not accept them
  uint32_t from_device_discarded_bytes = 0;  // received without a link, or not sent when it ended
  uint32_t to_device_discarded_bytes = 0;    // was not delivered when a link ended
  uint32_t links = 0;
  uint32_t refused = 0;
  uint32_t ends[static_cast<size_t>(LinkEnd::kCount)] = {};
};

/*
  state      event                                 next
  joining    WiFi is up                            waiting, the first attempt at once
  joining    kRejoin_ms without WiFi               joining, asks the WiFi to join anew
  waiting    WiFi is gone                          joining
  waiting    attempt due, connect() succeeds       connected, both buffers empty; with a key: proving
  proving    the host has proven the key           connected, both buffers empty
  proving    it has not, for kProof_ms or wrongly; waiting, backoff doubled
             WiFi gone, peer closed
  waiting    attempt due, connect() fails          waiting, backoff doubled
  connected  WiFi gone, peer closed, write stalled waiting (joining if there is no WiFi)
             for kWriteStalled_ms, or no byte from
             the host kHostSilent_ms after the
             device asked for the time
*/
class Passthrough {
 public:
  static const uint32_t kRejoin_ms = 20000;
  static const uint32_t kWriteStalled_ms = 2000;
  static const uint32_t kHostSilent_ms = 6000;  // a device requests the time every 2.5 s and falls silent after 11 s

  static const uint32_t kProof_ms = 4000;  // the host gives up after 3 s

  Passthrough(Uart& uart, Network& network, uint32_t seed);

  // From the next connection on, host and device prove that they share this key; empty: no proof.
  void set_key(const char* key, uint32_t (*random)()) { proof_.set_key(key, random); }

  // Whether the shell should call Network::connect() now and report to connection_tried().
  bool wants_connection(uint32_t now_ms) const;
  void connection_tried(bool is_connected, uint32_t now_ms);

  // One turn of the loop: check the link, move bytes both ways.
  void step(uint32_t now_ms);

  LinkState state() const { return state_; }
  const Counters& counters() const { return counters_; }
  uint32_t swallowed_bytes() const { return from_device_.swallowed_bytes(); }

 private:
  void step_joining(uint32_t now_ms);
  void step_proving(uint32_t now_ms);
  void begin_link(uint32_t now_ms);
  void step_connected(uint32_t now_ms);
  bool read_host(uint32_t now_ms);
  void write_device(uint32_t now_ms);
  void read_device(uint32_t now_ms);
  void report_signal(uint32_t now_ms);
  bool write_host(uint32_t now_ms);
  void end_link(LinkEnd end, uint32_t now_ms);
  void retry_in(uint32_t delay_ms, uint32_t now_ms);
  void discard_from_device();

  Uart& uart_;
  Network& network_;
  Backoff backoff_;
  KeyProof proof_;
  SignalReport signal_;
  FrameAssembler from_device_;
  FrameAssembler to_device_;
  Counters counters_;
  LinkState state_ = LinkState::kJoining;
  uint32_t state_since_ms_ = 0;
  uint32_t retry_after_ms_ = 0;
  uint32_t stalled_since_ms_ = 0;
  uint32_t asked_since_ms_ = 0;
  bool is_stalled_ = false;
  bool is_asked_ = false;
};

}  // namespace hostlink
