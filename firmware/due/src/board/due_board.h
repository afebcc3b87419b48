// The Arduino Due with its motor shield, encoders and Serial1. Only this file and due_board.cpp include
// Arduino.h.
#pragma once

#include "../hal.h"

namespace hostlink {

class DueBoard : public Hal {
 public:
  void begin();
  void run();  // on each turn of loop()

  uint32_t milliseconds() override;
  uint32_t micros() override;
  int read() override;
  size_t write(const uint8_t* data, size_t size) override;
  void drive(int16_t left_pwm, int16_t right_pwm) override;
  void edges(uint32_t& left, uint32_t& right) override;
  float battery_v() override;
  bool was_hung() override;

 private:
  bool is_quiet_ = false;
  bool is_watched_ = false;
  uint32_t started_at_ms_ = 0;
};

}  // namespace hostlink
