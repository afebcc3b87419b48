// RandomNumbers: PCG32 (O'Neill 2014, XSH-RR) and normal numbers by Box and Muller.
#pragma once

#include <stdint.h>

namespace hostlink {

class RandomNumbers {
 public:
  RandomNumbers(uint64_t seed, uint64_t stream);
  double uniform();  // in (0, 1)
  double normal();   // mean 0, standard deviation 1

 private:
  uint32_t next();

  uint64_t state_ = 0;
  uint64_t increment_;
};

}  // namespace hostlink
