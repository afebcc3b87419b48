#include "robot_in_world.h"

namespace hostlink {

namespace {

const char* const kColumnNames[RobotInWorld::kColumns] = {
    "t_s",
    "x_m",
    "y_m",
    "theta_rad",
    "odometry_x_m",
    "odometry_y_m",
    "odometry_theta_rad",
    "left_ticks_s",
    "right_ticks_s",
    "left_measured_ticks_s",
    "right_measured_ticks_s",
    "left_set_ticks_s",
    "right_set_ticks_s",
    "left_pwm",
    "right_pwm",
    "left_edges",
    "right_edges",
    "left_rolled_ticks",
    "right_rolled_ticks",
    "left_fault",
    "right_fault",
    "rolled_m",
    "battery_v",
    "caster_rad",
};

}  // namespace

void VirtualBoard::step_us(uint32_t us) {
  now_us_ += us;
  clock_us_ += static_cast<uint64_t>(us) * clock_per_mille_ / 1000;
  ring_.run_until(line_us());
  world_.run_until(line_us());
}

void VirtualBoard::cut() {
  ring_ = UartRing(baud_);
  out_ = UartOut(baud_);
}

void VirtualBoard::restart() {
  cut();
  clock_us_ = 0;
}

RobotInWorld::RobotInWorld(const WorldParameters& parameters, uint32_t baud, const char* name, ros::Retry retry,
                           Feedback feedback, const ControlProfile& profile)
    : name_(name),
      retry_(retry),
      feedback_(feedback),
      profile_(profile),
      board_(baud),
      robot_(board_, name, retry, feedback, profile) {
  world().be(parameters);
  board_.step_us(0);
  robot_.setup();
}

void RobotInWorld::reboot() {
  board_.restart();
  robot_.~Firmware();
  new (&robot_) Firmware(board_, name_, retry_, feedback_, profile_);
  wait_ms_ = 0;
  robot_.setup();
}

void RobotInWorld::pass() {
  board_.step_us(kPassUs);
  if (wait_ms_ > 0) --wait_ms_;
  if (wait_ms_ == 0) wait_ms_ = robot_.loop();
}

uint32_t RobotInWorld::quiet_ms() {
  return board_.is_line_idle() ? robot_.turn_due_in_us() / board_.clock_per_mille() + 1 : 0;
}

void RobotInWorld::report(double* row) const {
  const World& world = board_.world();
  const Wheel& left = robot_.left();
  const Wheel& right = robot_.right();
  const double values[kColumns] = {
      static_cast<double>(board_.now_us()) * 1e-6,
      world.pose().x_m,
      world.pose().y_m,
      world.pose().theta_rad,
      robot_.pose().x_m,
      robot_.pose().y_m,
      robot_.pose().theta_rad,
      world.left().speed_ticks_s(),
      world.right().speed_ticks_s(),
      static_cast<double>(left.speed_ticks_s()),
      static_cast<double>(right.speed_ticks_s()),
      static_cast<double>(left.set_point_ticks_s()),
      static_cast<double>(right.set_point_ticks_s()),
      static_cast<double>(world.left_pwm()),
      static_cast<double>(world.right_pwm()),
      static_cast<double>(world.left().edges()),
      static_cast<double>(world.right().edges()),
      world.left().rolled_ticks(),
      world.right().rolled_ticks(),
      static_cast<double>(left.fault()),
      static_cast<double>(right.fault()),
      world.rolled_m(),
      world.battery_v(),
      world.caster_rad(),
  };
  for (size_t i = 0; i < kColumns; ++i) row[i] = values[i];
}

const char* RobotInWorld::column(size_t index) { return kColumnNames[index]; }

}  // namespace hostlink
