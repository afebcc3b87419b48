// Stand-in for I2C: one chip with 256 registers, which the lines "register N VALUE" set (board.cpp).
#pragma once

#include "Arduino.h"

class TwoWire {
 public:
  void begin() {}
  void beginTransmission(uint8_t) { has_register_ = false; }
  size_t write(uint8_t byte);
  uint8_t endTransmission(bool = true) { return 0; }
  uint8_t requestFrom(uint8_t, uint8_t count);
  int available() { return left_; }
  int read();

 private:
  uint8_t register_ = 0;
  bool has_register_ = false;
  int left_ = 0;
};

extern TwoWire Wire;
