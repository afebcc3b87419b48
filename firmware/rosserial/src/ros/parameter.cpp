#include "parameter.h"

namespace ros {

namespace {

const uint32_t kAnswerTimeoutMs = 1000;
const char kRefused[] ROS_IN_FLASH = "parameter refused: out of range or of another type";

}  // namespace

void Parameters::add(ParameterBase& parameter) {
  ParameterBase** last = &first_;
  for (; *last != nullptr; last = &(*last)->next_) {
    if (*last == &parameter) return;
  }
  *last = &parameter;
}

void Parameters::spin(Node& node) {
  const bool is_configured = node.is_configured();
  const bool is_new = is_configured != was_configured_;
  if (is_new || node.announcements() != announcements_) {
    was_configured_ = is_configured;
    announcements_ = node.announcements();
    requested_ = is_configured ? first_ : nullptr;
    is_requested_ = false;
    node.forget_parameter(this);
    if (is_new) is_done_ = requested_ == nullptr && (is_done_ || is_configured);
  }
  if (requested_ == nullptr) return;
  if (is_requested_) {
    const bool is_over = node.milliseconds() - requested_at_ms_ > kAnswerTimeoutMs;
    if (!is_answered_ && !is_over) return;
    if (!is_answered_) node.forget_parameter(this);
    is_requested_ = false;
    requested_ = requested_->next_;
    if (requested_ == nullptr) {
      is_done_ = true;
      return;
    }
  }
  is_answered_ = false;
  is_requested_ = node.request_parameter(requested_->name_, &Parameters::receive, this);
  requested_at_ms_ = node.milliseconds();
}

void Parameters::receive(ParameterAnswer& answer) {
  if (!is_requested_) return;
  is_answered_ = true;
  if (answer.is_empty()) return;
  if (requested_->use_(*requested_, answer)) {
    requested_->is_from_host_ = true;
  } else {
    node()->log(Level::kWarn, FlashText(kRefused));
  }
}

}  // namespace ros
