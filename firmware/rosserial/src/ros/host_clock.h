// The host's time, from its answers and the board's own clock, which is wrong by up to half a percent.
#pragma once

#include "time.h"

namespace ros {

class HostClock {
 public:
  // The board asks at now_ms.
  void request(uint32_t now_ms) { requested_at_ms_ = now_ms; }
  // The host's time at about the middle between request and answer.
  void answer(const Time& host, uint32_t now_ms);
  void set(const Time& host, uint32_t now_ms);
  // Call it regularly: the board's milliseconds wrap.
  void advance(uint32_t now_ms);

  // Never goes back, unless the host's clock was set by more than a second. Zero: no answer has arrived.
  Time now(uint32_t now_ms);
  bool is_set() const { return is_set_; }
  uint32_t round_trip_ms() const { return round_trip_ms_; }
  int32_t drift_ppm() const { return drift_ppm_; }  // how much faster the host's clock runs
  Duration offset(uint32_t now_ms) const;           // offset to the board's time since its start

 private:
  Time compute(uint32_t now_ms) const;
  void measure_drift(const Time& host, uint32_t now_ms);

  Time base_;  // the host's time at base_ms_
  Time last_;  // that was read
  Time anchor_;
  uint32_t base_ms_ = 0;
  uint32_t anchor_ms_ = 0;  // start of the present measurement of the drift
  uint32_t requested_at_ms_ = 0;
  uint32_t round_trip_ms_ = 0;
  int32_t drift_ppm_ = 0;
  bool is_set_ = false;
  bool has_drift_ = false;
};

}  // namespace ros
