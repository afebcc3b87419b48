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
  explicit VirtualBoard(uint32_t baud) : baud_(baud), ring_(baud), out_(baud) {}

  // The board's own clock: from its power-up, and as fast as set_clock() says.
  uint32_t milliseconds() override { return static_cast<uint32_t>(clock_us_ / 1000); }
  uint32_t micros() override { return static_cast<uint32_t>(clock_us_); }
  int read() override { return ring_.read(); }
  size_t write(const uint8_t* data, size_t size) override { return out_.put(data, size, line_us()); }

  void step_us(uint32_t us);  // work of the hardware between two passes of the loop
  void set_clock(uint32_t per_mille) { clock_per_mille_ = per_mille; }  // 1250: a quarter too fast
  void cut();                                                           // drop what is on the line, both ways
  void restart();                                                       // power off and on
  bool is_line_idle() const { return ring_.is_idle() && out_.is_idle(); }
  uint32_t clock_per_mille() const { return clock_per_mille_; }
  uint64_t now_us() const { return now_us_; }                          // the world's time
  uint32_t line_us() const { return static_cast<uint32_t>(now_us_); }  // the same time, as the line counts it
  World& world() { return world_; }
  const World& world() const { return world_; }
  UartRing& from_host() { return ring_; }
  UartOut& to_host() { return out_; }

 private:
  uint64_t now_us_ = 0;
  uint64_t clock_us_ = 0;
  uint32_t clock_per_mille_ = 1000;
  uint32_t baud_;
  UartRing ring_;
  UartOut out_;
};

class RobotInWorld {
 public:
  static const uint32_t kPassUs = 1000;
  static const size_t kColumns = 24;

  // `baud` 0: bytes pass at once. `name` must outlive the object.
  RobotInWorld(const WorldParameters& parameters, uint32_t baud, const char* name, ros::Retry retry,
               Feedback feedback = Feedback::kWashedOut, const ControlProfile& profile = paper_profile());

  void pass();    // a millisecond of the world, then a pass of the firmware's loop
  void reboot();  // power off and on: the firmware starts again, the world continues
  void report(double* row) const;
  // Time for which nothing leaves the UART, unless a byte arrives from the host; 0: bytes are on the line.
  uint32_t quiet_ms();
  static const char* column(size_t index);

  VirtualBoard& board() { return board_; }
  World& world() { return board_.world(); }
  Robot& robot() { return robot_; }

 private:
  // A Robot that is constructed again in place; the Cortex-M3 has no header <new>.
  struct Firmware : Robot {
    using Robot::Robot;
    static void* operator new(size_t, void* at) { return at; }
  };

  const char* name_;
  ros::Retry retry_;
  Feedback feedback_;
  ControlProfile profile_;
  VirtualBoard board_;
  Firmware robot_;
  uint32_t wait_ms_ = 0;  // of the paper's retry clause
};

}  // namespace hostlink
