// SignalReport: the strength of the WiFi as a line of the device's log: a whole rosserial frame of the passthrough
// itself, inserted directly after a whole frame of the device. So it cuts no frame, and a device that does not speak
// rosserial gets none.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace hostlink {

class SignalReport {
 public:
  static const uint32_t kSoonest_ms = 10000;  // after a change
  static const uint32_t kLatest_ms = 60000;
  static const int kChange_dbm = 5;
  static const size_t kFrameBytesMax = 40;
  static const int kWeak_dbm = -80;  // below it packets are lost and sent again

  void restart() { has_reported_ = was_weak_ = false; }
  bool is_due(int signal_dbm, uint32_t now_ms) const;
  // Writes the frame and returns its size.
  size_t write(int signal_dbm, uint32_t now_ms, uint8_t* frame);

 private:
  uint32_t reported_at_ms_ = 0;
  int reported_dbm_ = 0;
  bool has_reported_ = false;
  bool was_weak_ = false;  // one warning when the signal becomes weak
};

}  // namespace hostlink
