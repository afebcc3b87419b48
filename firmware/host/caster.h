// Caster: the swivel wheel behind the axle. It swings until it trails, and twists the robot meanwhile.
//
// The wheel rolls freely along its heading b and scrubs across it, so its pivot pulls the tail sideways by cos(b)
// during the swing; over a whole swing this sums up to the change of sin(b). Wheels that turn the robot on the spot
// resist it; wheels that roll straight do not (the paper's "overturning"): cos2 of the pivot's course is the share.
#pragma once

#include "random_numbers.h"

namespace hostlink {

struct CasterParameters {
  double arm_m;
  double trail_m;
  double twist_rad;
  double random;
};

class Caster {
 public:
  static const uint64_t kStream = 3;

  void be(const CasterParameters& parameters, uint64_t seed);
  // The robot moved this far; returns the angle by which the caster twists it.
  double step(double forward_m, double turned_rad);
  // Resistance of the caster to such a motion: 0 it trails, 1 it points the other way.
  double resistance(double forward_m, double turned_rad) const;
  double heading_rad() const { return heading_rad_; }

 private:
  double begin(double off_rad);

  CasterParameters caster_ = {0.0, 0.0, 0.0, 0.0};
  RandomNumbers random_{1, kStream};
  double heading_rad_ = 0.0;  // its rolling direction, in the robot's frame
  double factor_ = 1.0;       // of this swing's twist
  bool is_swinging_ = false;
  bool is_ahead_ = true;  // its heading has a forward component
};

}  // namespace hostlink
