#include "self_report.h"

#include "messages.h"
#include "text.h"

namespace hostlink {

namespace {

const float kSmoothing = 0.1f;   // of the newest tenth of a second
const float kRecoveredV = 0.3f;  // above the limit

}  // namespace

const size_t Errors::kMost;
const uint32_t Errors::kShownMs;

void Errors::raise(Error error, uint32_t now_ms) {
  const uint8_t number = static_cast<uint8_t>(error);
  size_t at = 0;
  while (at < count_ && entries_[at].number < number) ++at;
  if (at == count_ || entries_[at].number != number) {
    if (count_ == kMost) return;
    for (size_t i = count_++; i > at; --i) entries_[i] = entries_[i - 1];
    entries_[at].number = number;
    has_changed_ = true;
  }
  entries_[at].at_ms = now_ms;
}

size_t Errors::list(uint8_t* numbers, uint32_t now_ms) {
  size_t kept = 0;
  for (size_t i = 0; i < count_; ++i) {
    if (now_ms - entries_[i].at_ms >= kShownMs) continue;
    numbers[kept] = entries_[i].number;
    entries_[kept++] = entries_[i];
  }
  has_changed_ = has_changed_ || kept != count_;
  count_ = kept;
  return kept;
}

bool Errors::has_changed() {
  const bool has = has_changed_;
  has_changed_ = false;
  return has;
}

void Battery::add(float volts) {
  const bool is_number = volts - volts == 0.0f;
  if (!is_number || !is_measured()) {
    volts_ = is_number ? volts : kNotMeasured;
  } else {
    volts_ += kSmoothing * (volts - volts_);
  }
  if (!(volts_ < (is_low() ? low_v_ + kRecoveredV : low_v_))) {
    low_turns_ = 0;  // also when the battery is not measured
  } else if (low_turns_ < kLowTurns) {
    ++low_turns_;
  }
}

void SelfReport::advertise(ros::NodeApi& node) {
  node.advertise(battery_topic_);
  node.advertise(errors_topic_);
}

void SelfReport::publish(ros::NodeApi& node, float battery_v, uint32_t now_ms) {
  check_battery(node, battery_v, now_ms);
  check_link(node, now_ms);
  uint8_t numbers[Errors::kMost];
  const size_t count = errors_.list(numbers, now_ms);
  uint8_t payload[kUInt16MultiArrayBytes + 2 * Errors::kMost] = {};
  for (size_t i = 0; i < count; ++i) payload[kUInt16MultiArrayBytes + 2 * i] = numbers[i];
  payload[kUInt16MultiArrayBytes - 4] = static_cast<uint8_t>(count);
  const bool is_due = ++turns_ >= kEvery;
  if (errors_.has_changed() || is_due) errors_topic_.publish(payload, kUInt16MultiArrayBytes + 2 * count);
  if (!is_due) return;
  turns_ = 0;
  if (battery_.is_measured()) publish_battery();
}

void SelfReport::check_battery(ros::NodeApi& node, float battery_v, uint32_t now_ms) {
  const bool was_low = battery_.is_low();
  battery_.add(battery_v);
  if (!battery_.is_low()) return;
  errors_.raise(Error::kBatteryLow, now_ms);
  if (was_low) return;
  Text text;
  text.add("battery low: ").add(battery_.volts(), 1).add(" V, below ").add(battery_.low_v(), 1).add(" V");
  node.logerror(text.chars());
}

void SelfReport::check_link(const ros::NodeApi& node, uint32_t now_ms) {
  if (node.dropped_from_host() != from_host_) errors_.raise(Error::kFromHost, now_ms);
  if (node.refused() != not_expected_) errors_.raise(Error::kNotExpected, now_ms);
  if (node.dropped_to_host() != not_sent_) errors_.raise(Error::kNotSent, now_ms);
  from_host_ = node.dropped_from_host();
  not_expected_ = node.refused();
  not_sent_ = node.dropped_to_host();
}

void SelfReport::publish_battery() {
  uint8_t payload[kBatteryStateBytes] = {};  // no stamp, no frame, no cells, no names
  write_float32(payload + kBatteryVoltageAt, battery_.volts());
  // Temperature, current, charge, capacities and percentage are NaN: not measured.
  for (size_t i = 1; i < kBatteryFloats; ++i) write_float32(payload + kBatteryVoltageAt + 4 * i, kNotMeasured);
  payload[kBatteryPresentAt] = 1;
  battery_topic_.publish(payload, sizeof payload);
}

}  // namespace hostlink
