#include "random_numbers.h"

#include <math.h>

namespace hostlink {

namespace {

const uint64_t kMultiplier = 6364136223846793005u;
const double kTurnRad = 6.283185307179586;

}  // namespace

RandomNumbers::RandomNumbers(uint64_t seed, uint64_t stream) : increment_((stream << 1) | 1) {
  next();
  state_ += seed;
  next();
}

uint32_t RandomNumbers::next() {
  const uint64_t old = state_;
  state_ = old * kMultiplier + increment_;
  const uint32_t shifted = static_cast<uint32_t>(((old >> 18) ^ old) >> 27);
  const uint32_t turn = static_cast<uint32_t>(old >> 59);
  return (shifted >> turn) | (shifted << ((0u - turn) & 31u));
}

double RandomNumbers::uniform() { return (static_cast<double>(next()) + 0.5) / 4294967296.0; }

double RandomNumbers::normal() {
  const double radius = sqrt(-2.0 * log(uniform()));
  return radius * cos(kTurnRad * uniform());
}

}  // namespace hostlink
