#include "service_client.h"

namespace ros {

namespace {

const uint32_t kLateMs = 5000;  // for this time a host may still answer the call

}  // namespace

void CallDeadline::start(uint32_t now_ms, uint32_t timeout_ms) {
  since_ms_ = now_ms;
  timeout_ms_ = timeout_ms;
  state_ = State::kRunning;
}

bool CallDeadline::finish() {
  const bool was_running = is_running();
  state_ = State::kIdle;
  return was_running;
}

void CallDeadline::spin(Node& node) {
  const bool is_over = !node.is_configured() || node.milliseconds() - since_ms_ >= timeout_ms_;
  if (state_ == State::kIdle || !is_over) return;
  const bool was_running = is_running();
  state_ = was_running && node.is_configured() ? State::kLate : State::kIdle;
  since_ms_ = node.milliseconds();
  timeout_ms_ = kLateMs;
  if (was_running) expire();
}

}  // namespace ros
