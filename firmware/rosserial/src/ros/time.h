// A moment since 1970, like ROS's.
#pragma once

#include <stdint.h>

#include "duration.h"

namespace ros {

struct Time {
  uint32_t sec = 0;
  uint32_t nsec = 0;

  Time() {}
  Time(uint32_t seconds, uint32_t nanoseconds) : sec(seconds), nsec(nanoseconds) {}

  double toSec() const { return static_cast<double>(sec) + 1e-9 * static_cast<double>(nsec); }
  Time& fromSec(double seconds);
  bool isZero() const { return sec == 0 && nsec == 0; }

  Time& operator+=(const Duration& duration);
  Time& operator-=(const Duration& duration);
  bool operator==(const Time& other) const { return sec == other.sec && nsec == other.nsec; }
  bool operator<(const Time& other) const { return sec < other.sec || (sec == other.sec && nsec < other.nsec); }
};

inline Time operator+(Time time, const Duration& duration) { return time += duration; }
inline Time operator-(Time time, const Duration& duration) { return time -= duration; }
// For times within 68 years of each other.
Duration operator-(const Time& later, const Time& earlier);

}  // namespace ros
