#include "host_clock.h"

namespace ros {

namespace {

const uint32_t kMeasuredMs = 20000;  // a millisecond of jitter is 50 ppm then
const uint32_t kAdvanceMs = 30000;
const uint32_t kRoundTripMaxMs = 2000;  // ignore an answer that is older
const uint32_t kWorseMs = 20;           // an answer that took this much longer is worse than the board's own clock
const int32_t kDriftMaxPpm = 20000;     // a resonator has 5000
const int32_t kJumpS = 1;
const int32_t kNsPerMs = 1000000;

Duration milliseconds(uint32_t count) {
  return Duration(static_cast<int32_t>(count / 1000), static_cast<int32_t>(count % 1000) * kNsPerMs);
}

bool has_jumped(const Duration& difference) { return difference.sec >= kJumpS || difference.sec < -kJumpS; }

}  // namespace

void HostClock::answer(const Time& host, uint32_t now_ms) {
  const uint32_t round_trip_ms = now_ms - requested_at_ms_;
  if (is_set_ && round_trip_ms > round_trip_ms_ + kWorseMs) {
    if (round_trip_ms_ + 2 * kWorseMs <= kRoundTripMaxMs) round_trip_ms_ += kWorseMs;  // the network may be slower now
    return;
  }
  round_trip_ms_ = round_trip_ms <= kRoundTripMaxMs ? round_trip_ms : 0;
  const Time present = host + milliseconds(round_trip_ms_ / 2);
  if (!is_set_ || has_jumped(present - compute(now_ms))) {
    set(present, now_ms);
    return;
  }
  measure_drift(present, now_ms);
  base_ = present;
  base_ms_ = now_ms;
}

void HostClock::set(const Time& host, uint32_t now_ms) {
  base_ = last_ = anchor_ = host;
  base_ms_ = anchor_ms_ = now_ms;
  is_set_ = true;
}

void HostClock::measure_drift(const Time& host, uint32_t now_ms) {
  const uint32_t elapsed_ms = now_ms - anchor_ms_;
  if (elapsed_ms < kMeasuredMs) return;
  const Duration drifted = (host - anchor_) -= milliseconds(elapsed_ms);
  anchor_ = host;
  anchor_ms_ = now_ms;
  if (has_jumped(drifted)) return;
  const int32_t drifted_us = drifted.sec * 1000000 + drifted.nsec / 1000;
  const int32_t ppm = drifted_us * 8 / static_cast<int32_t>(elapsed_ms / 125);  // microseconds in a second
  if (ppm > kDriftMaxPpm || ppm < -kDriftMaxPpm) return;
  drift_ppm_ = has_drift_ ? drift_ppm_ + (ppm - drift_ppm_) / 4 : ppm;
  has_drift_ = true;
}

void HostClock::advance(uint32_t now_ms) {
  if (!is_set_ || now_ms - base_ms_ < kAdvanceMs) return;
  base_ = compute(now_ms);
  base_ms_ = now_ms;
}

Time HostClock::now(uint32_t now_ms) {
  if (!is_set_) return Time();
  const Time present = compute(now_ms);
  if (last_ < present) last_ = present;
  return last_;
}

Duration HostClock::offset(uint32_t now_ms) const {
  return is_set_ ? compute(now_ms) - (Time() + milliseconds(now_ms)) : Duration();
}

Time HostClock::compute(uint32_t now_ms) const {
  const uint32_t elapsed_ms = now_ms - base_ms_;
  // Milliseconds times parts per million are nanoseconds. A base that is older than advance() allows has none.
  const int32_t drifted_ns = elapsed_ms < 2 * kAdvanceMs ? static_cast<int32_t>(elapsed_ms) * drift_ppm_ : 0;
  const Duration elapsed = milliseconds(elapsed_ms);
  return base_ + Duration(elapsed.sec, elapsed.nsec + drifted_ns);
}

}  // namespace ros
