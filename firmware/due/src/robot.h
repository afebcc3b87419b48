// Robot: the paper's robot over a Hal: its topics, its 30 Hz loop, and its safety stops. Every state of loop() either
// feeds the motors or stops them.
#pragma once

#include <ros/node_handle.h>
#include <stdint.h>

#include "drive.h"
#include "hal.h"
#include "self_report.h"
#include "wheel.h"

namespace hostlink {

// Ids from 100 and 125, messages of 512 bytes at most, and 2048 bytes of them on their way to the host.
typedef ros::BufferedNode<25, 25, 512, 512, 2048> RobotNode;

class Robot {
 public:
  explicit Robot(Hal& hal, const char* name = "/robot_0/", ros::Retry retry = ros::Retry::kKeepState,
                 Feedback feedback = Feedback::kWashedOut, const ControlProfile& profile = paper_profile());

  void setup();
  // Call it as often as possible: it drains the UART on each call, and controls thirty times a second. Returns 0, or
  // with the paper's retry clause the milliseconds to wait before the next call.
  uint32_t loop();

  // Time until the next turn of the control. Unless a byte arrives from the host, the robot sends nothing before it.
  uint32_t turn_due_in_us();

  const Pose& pose() const { return pose_; }
  const Wheel& left() const { return left_; }
  const Wheel& right() const { return right_; }
  RobotNode& node() { return node_; }

 private:
  static void receive_velocity(void* self, const uint8_t* payload, size_t size);
  static void receive_reset(void* self, const uint8_t* payload, size_t size);
  static void receive_left_gains(void* self, const uint8_t* payload, size_t size);
  static void receive_right_gains(void* self, const uint8_t* payload, size_t size);
  static void receive_parameter(void* self, ros::ParameterAnswer& answer);

  void guard();
  void turn(float dt_s);
  void watch();
  bool log_fault(const Wheel& wheel, const char* side);
  void raise(Error error) { report_.raise(error, hal_.milliseconds()); }
  void raise_faults();
  void stop();
  void greet();
  void use_parameter(const float* values, size_t count);
  bool apply_values(const float* values, size_t count);
  void refuse_parameter();
  void log_geometry();
  void log_radii();
  void log_ticks();
  void publish();
  void tune(Wheel& wheel, const Gains& gains);
  void log_trouble();

  Hal& hal_;
  RobotNode node_;
  ros::RawPublisher odometry_;
  ros::RawPublisher plot_;
  ros::RawSubscriber velocity_;
  ros::RawSubscriber reset_;
  ros::RawSubscriber left_gains_;
  ros::RawSubscriber right_gains_;
  SelfReport report_;
  Drive drive_;
  Wheel left_;
  Wheel right_;
  Pose pose_ = {0.0, 0.0, 0.0};
  uint32_t turned_at_us_ = 0;  // the last turn
  uint32_t due_since_us_ = 0;  // the steady grid of turns
  uint32_t commanded_at_ms_ = 0;
  bool is_commanded_ = false;
  bool is_faulted_ = false;  // a wheel stalled or ran away
  bool has_zero_ = false;    // a zero velocity has arrived since
  uint32_t left_edges_ = 0;
  uint32_t right_edges_ = 0;
  uint8_t turns_ = 0;
  bool was_configured_ = false;
  bool was_hung_logged_ = false;
  uint8_t requested_ = 0;  // the requested parameter; 0: none
  uint32_t requested_at_ms_ = 0;
  bool has_new_geometry_ = false;  // of the wheels, since it was logged
  uint32_t logged_trouble_ = 0;
  uint32_t logged_trouble_at_ms_ = 0;
};

}  // namespace hostlink
