#include "passthrough.h"

namespace hostlink {

const uint32_t Backoff::kFirst_ms;
const uint32_t Backoff::kLongest_ms;
const uint32_t Passthrough::kRejoin_ms;
const uint32_t Passthrough::kWriteStalled_ms;
const uint32_t Passthrough::kHostSilent_ms;
const uint32_t Passthrough::kProof_ms;

namespace {
const uint16_t kTimeId = 10;
const size_t kTurnBytes = 256;  // the most that one turn reads from a port: 67 ms of the UART

// A byte lasts 0.26 ms at 38400 baud: 20 ms of silence is an end, 270 ms the longest frame.
const Hold kFromDeviceHold = {20, 500};
// A lost TCP segment is sent again after 200 ms or more; the device would give up half a frame after 20 ms.
const Hold kToDeviceHold = {500, 1000};

size_t least(size_t a, size_t b) { return a < b ? a : b; }
}  // namespace

Passthrough::Passthrough(Uart& uart, Network& network, uint32_t seed)
    : uart_(uart), network_(network), backoff_(seed), from_device_(kFromDeviceHold), to_device_(kToDeviceHold) {}

bool Passthrough::wants_connection(uint32_t now_ms) const {
  return state_ == LinkState::kWaiting && now_ms - state_since_ms_ >= retry_after_ms_;
}

void Passthrough::connection_tried(bool is_connected, uint32_t now_ms) {
  discard_from_device();
  if (!is_connected) {
    ++counters_.refused;
    retry_in(backoff_.next_ms(), now_ms);
    return;
  }
  if (!proof_.has_key()) return begin_link(now_ms);
  proof_.begin();
  state_ = LinkState::kProving;
  state_since_ms_ = now_ms;
}

void Passthrough::begin_link(uint32_t now_ms) {
  ++counters_.links;
  counters_.to_device_discarded_bytes += static_cast<uint32_t>(to_device_.forget_unstarted());
  from_device_.restart(now_ms);
  signal_.restart();
  is_stalled_ = false;
  is_asked_ = false;
  state_ = LinkState::kConnected;
  state_since_ms_ = now_ms;
}

void Passthrough::step(uint32_t now_ms) {
  if (state_ == LinkState::kConnected) {
    step_connected(now_ms);
  } else {
    discard_from_device();
    if (state_ == LinkState::kProving) {
      step_proving(now_ms);
    } else {
      step_joining(now_ms);
    }
  }
  write_device(now_ms);
}

void Passthrough::step_joining(uint32_t now_ms) {
  const bool is_joined = network_.is_joined();
  if (is_joined && state_ == LinkState::kJoining) {
    retry_in(0, now_ms);
  } else if (!is_joined && state_ == LinkState::kWaiting) {
    state_ = LinkState::kJoining;
    state_since_ms_ = now_ms;
  } else if (!is_joined && now_ms - state_since_ms_ >= kRejoin_ms) {
    network_.rejoin();
    state_since_ms_ = now_ms;
  }
}

void Passthrough::step_proving(uint32_t now_ms) {
  uint8_t bytes[KeyProof::kAnswerBytes];
  const size_t count = network_.read(bytes, least(sizeof bytes, proof_.wanted_bytes()));
  proof_.take(bytes, count);
  const size_t waiting = least(proof_.to_say_bytes(), network_.room_bytes());
  if (waiting > 0) proof_.said(network_.write(proof_.to_say(), waiting));
  if (proof_.state() == KeyProof::State::kProven) return begin_link(now_ms);
  if (!network_.is_joined()) return end_link(LinkEnd::kWifiLost, now_ms);
  const bool is_late = now_ms - state_since_ms_ >= kProof_ms;
  if (proof_.state() == KeyProof::State::kRefused || is_late) return end_link(LinkEnd::kKeyRefused, now_ms);
  if (count == 0 && !network_.is_connected()) end_link(LinkEnd::kPeerClosed, now_ms);
}

void Passthrough::step_connected(uint32_t now_ms) {
  const bool has_read = read_host(now_ms);
  if (!network_.is_joined()) return end_link(LinkEnd::kWifiLost, now_ms);
  // Bytes that a host sent before it closed still count: they may be a stop.
  if (!has_read && to_device_.room_bytes() > 0 && !network_.is_connected())
    return end_link(LinkEnd::kPeerClosed, now_ms);
  read_device(now_ms);
  if (!write_host(now_ms)) return end_link(LinkEnd::kWriteStalled, now_ms);
  if (is_asked_ && now_ms - asked_since_ms_ >= kHostSilent_ms) end_link(LinkEnd::kHostSilent, now_ms);
}

bool Passthrough::read_host(uint32_t now_ms) {
  uint8_t bytes[kTurnBytes];
  const size_t count = network_.read(bytes, least(sizeof bytes, to_device_.room_bytes()));
  if (count == 0) return false;
  to_device_.put(bytes, count, now_ms);
  backoff_.reset();
  is_asked_ = false;
  return true;
}

void Passthrough::write_device(uint32_t now_ms) {
  const size_t ready = to_device_.ready_bytes(FrameAssembler::kCapacityBytes, now_ms);
  if (ready == 0) return;
  const size_t count = least(ready, uart_.room_bytes());
  if (count == 0) return;
  const size_t written = uart_.write(to_device_.head(), count);
  to_device_.take(written);
  counters_.to_device_bytes += static_cast<uint32_t>(written);
}

void Passthrough::read_device(uint32_t now_ms) {
  uint8_t bytes[kTurnBytes];
  const size_t count = uart_.read(bytes, sizeof bytes);
  while (from_device_.room_bytes() < count) {
    counters_.from_device_dropped_bytes += static_cast<uint32_t>(from_device_.drop_oldest());
  }
  from_device_.put(bytes, count, now_ms);
  if (count > 0) report_signal(now_ms);
}

// The device has just ended a frame, and there is room: no byte of the device is dropped for this line.
void Passthrough::report_signal(uint32_t now_ms) {
  const bool has_room = from_device_.room_bytes() >= SignalReport::kFrameBytesMax + FrameAssembler::kFrameBytesMax;
  const int signal_dbm = network_.signal_dbm();
  if (!signal_.is_due(signal_dbm, now_ms) || !has_room || !from_device_.ends_with_frame()) return;
  uint8_t frame[SignalReport::kFrameBytesMax];
  from_device_.put(frame, signal_.write(signal_dbm, now_ms, frame), now_ms);
}

// False when the network has not accepted bytes for too long.
bool Passthrough::write_host(uint32_t now_ms) {
  const size_t waiting = from_device_.ready_bytes(FrameAssembler::kCapacityBytes, now_ms);
  const size_t count = waiting == 0 ? 0 : from_device_.ready_bytes(network_.room_bytes(), now_ms);
  size_t written = 0;
  if (count > 0) {
    const bool asks_time = from_device_.has_frame(kTimeId, count);
    written = network_.write(from_device_.head(), count);
    from_device_.take(written);
    counters_.from_device_bytes += static_cast<uint32_t>(written);
    if (asks_time && !is_asked_) {
      is_asked_ = true;
      asked_since_ms_ = now_ms;
    }
  }
  const bool is_stalled = waiting > 0 && written == 0;
  if (is_stalled && !is_stalled_) stalled_since_ms_ = now_ms;
  is_stalled_ = is_stalled;
  return !is_stalled || now_ms - stalled_since_ms_ < kWriteStalled_ms;
}

void Passthrough::end_link(LinkEnd end, uint32_t now_ms) {
  network_.close();
  ++counters_.ends[static_cast<size_t>(end)];
  counters_.from_device_discarded_bytes += static_cast<uint32_t>(from_device_.size_bytes());
  from_device_.restart(now_ms);
  // Whole frames still reach the device until the next link is up; half a frame never does.
  counters_.to_device_discarded_bytes += static_cast<uint32_t>(to_device_.forget_incomplete());
  retry_in(backoff_.next_ms(), now_ms);
}

void Passthrough::retry_in(uint32_t delay_ms, uint32_t now_ms) {
  state_ = LinkState::kWaiting;
  state_since_ms_ = now_ms;
  retry_after_ms_ = delay_ms;
}

// Read until the port is empty, with a limit: a port that fills again is read in the next turn.
void Passthrough::discard_from_device() {
  uint8_t bytes[kTurnBytes];
  for (size_t turn = 0; turn < 8; ++turn) {
    const size_t count = uart_.read(bytes, sizeof bytes);
    counters_.from_device_discarded_bytes += static_cast<uint32_t>(count);
    if (count == 0) return;
  }
}

}  // namespace hostlink
