#include "caster.h"

#include <math.h>

namespace hostlink {

namespace {

const double kTurnRad = 6.283185307179586;
const double kHalfTurnRad = 3.141592653589793;
const double kTrailsRad = 0.1;     // below this angle to its course it trails
const double kSwingsRad = 0.5;     // above this angle a new swing has begun
const double kLeastOffRad = 0.05;  // no caster points exactly against its course

double half_turn(double angle_rad) { return angle_rad - kTurnRad * floor((angle_rad + kHalfTurnRad) / kTurnRad); }

}  // namespace

void Caster::be(const CasterParameters& parameters, uint64_t seed) {
  caster_ = parameters;
  random_ = RandomNumbers(seed, kStream);
}

double Caster::step(double forward_m, double turned_rad) {
  const double side_m = -caster_.arm_m * turned_rad;
  const double way_m = sqrt(forward_m * forward_m + side_m * side_m);
  if (way_m == 0.0) return 0.0;
  const double course_rad = atan2(side_m, forward_m);
  const double off_rad = begin(half_turn(course_rad - heading_rad_));
  const double after_rad = 2.0 * atan(tan(off_rad / 2.0) * exp(-way_m / caster_.trail_m));
  const double before_sin = sin(course_rad - off_rad);
  const double heading_rad = course_rad - after_rad;
  const double straight = forward_m / way_m;
  const double twist_rad = caster_.twist_rad * factor_ * straight * straight * (sin(heading_rad) - before_sin);
  heading_rad_ = half_turn(heading_rad - turned_rad - twist_rad);
  return twist_rad;
}

double Caster::resistance(double forward_m, double turned_rad) const {
  const double side_m = -caster_.arm_m * turned_rad;
  if (forward_m == 0.0 && side_m == 0.0) return 0.0;
  return (1.0 - cos(atan2(side_m, forward_m) - heading_rad_)) / 2.0;
}

// Draws the strength of a swing that begins or passes the right angle, and the side if it is undecided.
double Caster::begin(double off_rad) {
  const double size_rad = fabs(off_rad);
  const bool is_ahead = cos(heading_rad_) >= 0.0;
  const bool begins = !is_swinging_ && size_rad > kSwingsRad;
  if (begins || (is_swinging_ && is_ahead != is_ahead_)) factor_ = 1.0 + caster_.random * random_.normal();
  if (begins) {
    is_swinging_ = true;
  } else if (size_rad < kTrailsRad) {
    is_swinging_ = false;
  }
  is_ahead_ = is_ahead;
  if (kHalfTurnRad - size_rad >= kLeastOffRad) return off_rad;
  return (kHalfTurnRad - kLeastOffRad) * (random_.uniform() < 0.5 ? 1.0 : -1.0);
}

}  // namespace hostlink
