// The robot's report about itself, as numbers for programs: the battery's voltage and the robot's errors
// (docs/robot.md#what-the-robot-knows-of-itself). The lines of the log say the same for people.
#pragma once

#include <ros/node_handle.h>
#include <stddef.h>
#include <stdint.h>

#include "constants.h"
#include "messages.h"

namespace hostlink {

enum class Error : uint8_t {
  kLeftStalled = 11,
  kRightStalled = 12,
  kLeftRunaway = 21,
  kRightRunaway = 22,
  kNoCommand = 31,    // the wheels rolled without a command
  kHung = 32,         // the hardware watchdog restarted the board
  kNoNumber = 33,     // an invalid velocity (NaN or infinite)
  kRefused = 34,      // gains or a parameter out of range
  kFromHost = 41,     // bytes from the host that were not part of a frame
  kNotExpected = 42,  // frames with an unknown topic
  kNotSent = 43,      // messages to the host that found no room on the line
  kBatteryLow = 51,
};

// The distinct errors of the last ten seconds.
class Errors {
 public:
  static const size_t kMost = 12;
  static const uint32_t kShownMs = 10000;

  void raise(Error error, uint32_t now_ms);
  size_t list(uint8_t* numbers, uint32_t now_ms);  // ascending; older ones are forgotten
  bool has_changed();                              // since the last call

 private:
  struct Entry {
    uint8_t number;
    uint32_t at_ms;
  };
  Entry entries_[kMost] = {};
  size_t count_ = 0;
  bool has_changed_ = false;
};

// Smoothed over a second. Low means below the limit for five seconds: a starting motor costs a volt.
class Battery {
 public:
  static const uint8_t kLowTurns = 50;

  void add(float volts);  // ten times a second; NaN: not measured
  bool is_measured() const { return volts_ == volts_; }
  float volts() const { return volts_; }
  bool is_low() const { return low_turns_ == kLowTurns; }
  float low_v() const { return low_v_; }
  void set_low_v(float low_v) { low_v_ = low_v; }

 private:
  float volts_ = kNotMeasured;
  float low_v_ = kBatteryLowV;
  uint8_t low_turns_ = 0;
};

class SelfReport {
 public:
  void advertise(ros::NodeApi& node);
  void raise(Error error, uint32_t now_ms) { errors_.raise(error, now_ms); }
  // Ten times a second: publish the errors each second and when they change, and the battery each second if measured.
  void publish(ros::NodeApi& node, float battery_v, uint32_t now_ms);
  Battery& battery() { return battery_; }

 private:
  static const uint8_t kEvery = 10;

  void check_battery(ros::NodeApi& node, float battery_v, uint32_t now_ms);
  void check_link(const ros::NodeApi& node, uint32_t now_ms);
  void publish_battery();

  Errors errors_;
  Battery battery_;
  ros::RawPublisher battery_topic_ = {"battery", ros::FlashText(kBatteryStateType), ros::FlashText(kBatteryStateMd5)};
  ros::RawPublisher errors_topic_ = {"errors", ros::FlashText(kUInt16MultiArrayType),
                                     ros::FlashText(kUInt16MultiArrayMd5)};
  uint8_t turns_ = 0;
  uint32_t from_host_ = 0;  // the last counts
  uint32_t not_expected_ = 0;
  uint32_t not_sent_ = 0;
};

}  // namespace hostlink
