// Stand-in for the Servo library, which is in no package of Debian: to compile, not to link.
#pragma once

#include <stdint.h>

class Servo {
 public:
  uint8_t attach(int pin);
  void write(int angle_deg);
};
