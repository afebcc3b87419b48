#include "time.h"

namespace ros {

namespace {

const int32_t kNsPerS = 1000000000;

// The times wrap: a message may have any number in them.
int32_t sum(int32_t a, int32_t b) { return static_cast<int32_t>(static_cast<uint32_t>(a) + static_cast<uint32_t>(b)); }
int32_t difference(uint32_t a, uint32_t b) { return static_cast<int32_t>(a - b); }
int32_t difference(int32_t a, int32_t b) { return difference(static_cast<uint32_t>(a), static_cast<uint32_t>(b)); }

}  // namespace

Duration& Duration::fromSec(double seconds) {
  sec = static_cast<int32_t>(seconds);
  nsec = static_cast<int32_t>((seconds - static_cast<double>(sec)) * 1e9);
  return normalize();
}

Duration& Duration::normalize() {
  sec = sum(sec, nsec / kNsPerS);
  nsec %= kNsPerS;
  if (nsec < 0) {
    nsec += kNsPerS;
    sec = sum(sec, -1);
  }
  return *this;
}

Duration& Duration::operator+=(const Duration& other) {
  sec = sum(sec, other.sec);
  nsec = sum(nsec, other.nsec);
  return normalize();
}

Duration& Duration::operator-=(const Duration& other) {
  sec = difference(sec, other.sec);
  nsec = difference(nsec, other.nsec);
  return normalize();
}

Time& Time::fromSec(double seconds) {
  sec = static_cast<uint32_t>(seconds);
  nsec = static_cast<uint32_t>((seconds - static_cast<double>(sec)) * 1e9);
  return *this;
}

Time& Time::operator+=(const Duration& duration) {
  const Duration parts(0, sum(static_cast<int32_t>(nsec), duration.nsec));
  sec += static_cast<uint32_t>(duration.sec) + static_cast<uint32_t>(parts.sec);
  nsec = static_cast<uint32_t>(parts.nsec);
  return *this;
}

Time& Time::operator-=(const Duration& duration) {
  const Duration parts(0, difference(static_cast<int32_t>(nsec), duration.nsec));
  sec -= static_cast<uint32_t>(duration.sec);
  sec += static_cast<uint32_t>(parts.sec);
  nsec = static_cast<uint32_t>(parts.nsec);
  return *this;
}

Duration operator-(const Time& later, const Time& earlier) {
  return Duration(difference(later.sec, earlier.sec), difference(later.nsec, earlier.nsec));
}

}  // namespace ros
