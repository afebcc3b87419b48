// Stand-in for the Servo library.
#pragma once

#include "Arduino.h"

class Servo {
 public:
  uint8_t attach(int pin) { return static_cast<uint8_t>(pin_ = pin); }
  void write(int angle_deg);

 private:
  int pin_ = 0;
};
