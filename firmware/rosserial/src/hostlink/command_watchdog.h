// CommandWatchdog: stops the motors when no command has arrived for a while, or the host is lost: also while the sketch
// waits for a service or a parameter. Attach it to the node: nh.attach(watchdog).
#pragma once

#include "../ros/callable.h"
#include "../ros/node.h"

namespace hostlink {

const uint32_t kCommandTimeoutMs = 500;

/*
  state    event                                                next
  stopped  feed()                                               running
  running  no feed() for the time-out, or the host is gone      stopped, the stop is called
           stop()                                               stopped, the stop is called
  any      feed() in a callback whose message may have waited   stopped, the stop is called
           for longer than the time-out
*/
class CommandWatchdog : public ros::Task {
 public:
  // `stop`: a function, or a lambda that captures at most three references.
  template <class F>
  explicit CommandWatchdog(F stop, uint32_t timeout_ms = kCommandTimeoutMs) : stop_(stop), timeout_ms_(timeout_ms) {}

  // Report a command: call it in its callback, before the motors start. False: the watchdog could not stop them,
  // because it is not attached to a node, or the host is lost; or the loop was blocked, and the command is old. The
  // watchdog has called `stop` then.
  bool feed();
  void stop();
  bool is_running() const { return is_running_; }
  uint32_t stops() const { return stops_; }  // of its own

 private:
  void spin(ros::Node& node) override;
  bool is_late();

  ros::Callable<void()> stop_;
  uint32_t timeout_ms_;
  uint32_t fed_at_ms_ = 0;
  uint32_t stops_ = 0;
  bool is_running_ = false;
  bool has_logged_late_ = false;
};

}  // namespace hostlink
