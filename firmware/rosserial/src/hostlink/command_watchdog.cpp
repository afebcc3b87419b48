#include "command_watchdog.h"

namespace hostlink {

namespace {

const char kLate[] ROS_IN_FLASH = "command refused: the board's loop stood still for too long";

}  // namespace

bool CommandWatchdog::feed() {
  if (node() == nullptr || !node()->is_configured() || is_late()) {
    stop();
    return false;
  }
  fed_at_ms_ = node()->milliseconds();
  is_running_ = true;
  return true;
}

// A UART that overflows keeps the oldest bytes: a stop after them may be lost.
bool CommandWatchdog::is_late() {
  const bool is_late = node()->waited_ms() > timeout_ms_;
  if (is_late && !has_logged_late_) node()->log(ros::Level::kWarn, ros::FlashText(kLate));
  has_logged_late_ = is_late;
  return is_late;
}

void CommandWatchdog::stop() {
  is_running_ = false;
  stop_();
}

void CommandWatchdog::spin(ros::Node& node) {
  if (!is_running_) return;
  if (node.is_configured() && node.milliseconds() - fed_at_ms_ <= timeout_ms_) return;
  ++stops_;
  stop();
}

}  // namespace hostlink
