// A signed span of time, like ROS's.
#pragma once

#include <stdint.h>

namespace ros {

// 0 <= nsec < 1e9 after normalize(): -0.5 s is {-1, 500000000}.
struct Duration {
  int32_t sec = 0;
  int32_t nsec = 0;

  Duration() {}
  Duration(int32_t seconds, int32_t nanoseconds) : sec(seconds), nsec(nanoseconds) { normalize(); }
  explicit Duration(double seconds) { fromSec(seconds); }

  double toSec() const { return static_cast<double>(sec) + 1e-9 * static_cast<double>(nsec); }
  Duration& fromSec(double seconds);
  Duration& normalize();

  Duration& operator+=(const Duration& other);
  Duration& operator-=(const Duration& other);
  bool operator==(const Duration& other) const { return sec == other.sec && nsec == other.nsec; }
  bool operator<(const Duration& other) const { return sec < other.sec || (sec == other.sec && nsec < other.nsec); }
};

}  // namespace ros
