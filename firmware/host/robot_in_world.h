// RobotInWorld: the Due's firmware behind a UART, driving a World in virtual time: a clock that only moves when it is
// stepped, so that a minute of the robot takes milliseconds. For one thread; as many as there is memory for.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "../due/src/robot.h"
#include "uart_out.h"
#include "uart_ring.h"
#include "world_hal.h"

namespace hostlink {

class VirtualBoard : public WorldHal {
 public:
  explicit VirtualBoard(uint32_t baud) : ring_(baud), out_(baud) {}

  uint32_t milliseconds() override { return static_cast<uint32_t>(now_us_ / 1000); }
  uint32_t micros() override { return static_cast<uint32_t>(now_us_); }
  int read() override { return ring_.read(); }
  size_t write(const uint8_t* data, size_t size) override { return out_.put(data, size, micros()); }
  void step_us(uint32_t us);  // what the hardware does between two passes of the loop
  uint64_t now_us() const { return now_us_; }
  World& world() { return world_; }
  const World& world() const { return world_; }
  UartRing& from_host() { return ring_; }
  UartOut& to_host() { return out_; }

 private:
  uint64_t now_us_ = 0;
  UartRing ring_;
  UartOut out_;
};

class RobotInWorld {
 public:
  static const uint32_t kPassUs = 1000;
  static const size_t kColumns = 24;

  // `baud` 0: bytes are through at once. `name` stays the caller's.
  RobotInWorld(const WorldParameters& parameters, uint32_t baud, const char* name, ros::Retry retry,
               Feedback feedback = Feedback::kWashedOut);

  void pass();  // a millisecond of the world, then a pass of the firmware's loop
  void report(double* row) const;
  static const char* column(size_t index);

  VirtualBoard& board() { return board_; }
  World& world() { return board_.world(); }
  Robot& robot() { return robot_; }

 private:
  VirtualBoard board_;
  Robot robot_;
  uint32_t wait_ms_ = 0;  // of the paper's retry clause
};

}  // namespace hostlink
