// One wheel: set-point along a minimum-jerk curve, PID with a feedback term, motor output, signed ticks.
// Pure: dt is an argument, and there are no pins.
#pragma once

#include <stdint.h>

#include "constants.h"

namespace hostlink {

// Set-point that moves from its present value to a target along a minimum-jerk curve. Its slope is at most
// 1.875 / seconds_per_tick away from zero and 1.875 / slower_seconds_per_tick towards zero; it never passes the target.
// A further or nearer target in the same direction keeps the slope, so that commands which change ten times a second
// add up to one motion. A target in the other direction starts with slope zero. For a target of the other sign, or a
// target of zero, the set-point is zero at once.
class MinimumJerk {
 public:
  explicit MinimumJerk(float seconds_per_tick = kSecondsPerTick, float slower_seconds_per_tick = kSlowerSecondsPerTick)
      : seconds_per_tick_(seconds_per_tick), slower_seconds_per_tick_(slower_seconds_per_tick) {}
  void aim(float target);  // calling it again with the same target changes nothing
  void stop_at_once();     // set to zero now
  void begin_at_zero();    // go to the target from a standstill
  float step(float dt_s);
  float value() const { return value_; }
  float target() const { return target_; }

 private:
  float rising_phase() const;

  float seconds_per_tick_;
  float slower_seconds_per_tick_;
  float value_ = 0.0f;
  float target_ = 0.0f;
  float from_ = 0.0f;
  float elapsed_s_ = 0.0f;
  float length_s_ = 0.0f;
};

// e = wanted - measured - feedback * last output, or its changes only; no integral windup at the limit.
class Pid {
 public:
  explicit Pid(const Gains& gains, Feedback feedback = Feedback::kWashedOut) : gains_(gains), feedback_(feedback) {}
  // The output stays within low and high; the original's limits are those of the motor.
  float step(float wanted_ticks_s, float measured_ticks_s, float dt_s, float low = -static_cast<float>(kPwmMax),
             float high = static_cast<float>(kPwmMax));
  void reset();
  void scale_integral(float factor) { integral_ *= factor; }  // set the integral for another speed
  void tune(const Gains& gains) { gains_ = gains; }
  const Gains& gains() const { return gains_; }

 private:
  float fed_back_ticks_s(float dt_s);

  Gains gains_;
  Feedback feedback_;
  float output_ = 0.0f;
  float steady_ticks_s_ = 0.0f;  // the slow part of the output, which is not fed back
  float integral_ = 0.0f;
  float previous_error_ = 0.0f;
};

// 0 up to 10, at least 700 above, at most 4095; NaN is 0.
int16_t motor_output(float wanted);

// Mean speed over the last fifth of a second, and over the last turn: the filter of the PID lags by a third of a
// second.
class RecentSpeed {
 public:
  void add(float ticks, float dt_s);
  float ticks() const;
  float seconds() const;
  float last_ticks() const { return ticks_[(at_ + kTurns - 1) % kTurns]; }

 private:
  static const uint8_t kTurns = 6;
  float ticks_[kTurns] = {};
  float seconds_[kTurns] = {};
  uint8_t at_ = 0;
};

// The highest request of the last 0.3 s: a wheel follows its set-point with that delay.
class RecentRequest {
 public:
  void add(float ticks_s);
  float most() const;

 private:
  static const uint8_t kTurns = 9;
  float ticks_s_[kTurns] = {};
  uint8_t at_ = 0;
};

enum class WheelFault : uint8_t {
  kNone,
  kStalled,  // driven, and no edge: blocked, or its encoder is dead
  kRunaway,  // far too fast and not slowing down: something other than this program drives it
};

// One channel of an encoder has no sign, so the wheel must only roll in the direction in which it is driven:
//
//   | set-point         | wheel                         | motor                                                     |
//   |-------------------|-------------------------------|-----------------------------------------------------------|
//   | zero              | any                           | brakes; the edges keep their sign                         |
//   | along the sign    | faster than requested in the  | brakes, at the latest after 0.2 s                         |
//   |                   | last 0.3 s                    |                                                           |
//   | along the sign,   | faster than the set-point in  | brakes                                                    |
//   | has gone slower   | the last turn                 |                                                           |
//   | along the sign    | any                           | driven that way, or brakes: never a torque against it     |
//   | against the sign  | had an edge in the last 0.1 s | brakes; the set-point waits at zero                       |
//   | against the sign  | stopped: braked for 0.1 s,    | the sign changes, then it is driven                       |
//   |                   | without an edge               |                                                           |
class Wheel {
 public:
  explicit Wheel(const Gains& gains, Feedback feedback = Feedback::kWashedOut,
                 const ControlProfile& profile = paper_profile())
      : set_point_(profile.seconds_per_tick, profile.slower_seconds_per_tick),
        pid_(gains, feedback),
        filter_weight_(profile.filter_weight) {}

  void aim(float ticks_s) { set_point_.aim(ticks_s); }
  void stop_at_once() { set_point_.stop_at_once(); }
  // One turn of the loop with the edges that the encoder counted in it. Returns how far the wheel rolled, in ticks.
  // Rising and falling edges count: on the way back a wheel meets the same edge again, so a reversal costs nothing.
  // Rising edges alone are at another place on the way back, up to a tick away.
  float step(uint32_t edges, float dt_s);

  int16_t pwm() const { return pwm_; }  // of the last turn
  int16_t pwm_now() const { return set_point_.value() == 0.0f ? static_cast<int16_t>(0) : pwm_; }
  float speed_ticks_s() const { return speed_ticks_s_; }
  float set_point_ticks_s() const { return set_point_.value(); }
  float target_ticks_s() const { return set_point_.target(); }  // of the last command
  bool stands() const;
  WheelFault fault() const { return fault_; }  // kept until forgive()
  void forgive();
  Pid& pid() { return pid_; }
  const Pid& pid() const { return pid_; }

 private:
  float requested_ticks_s() const;
  void forget(float before, float wanted);
  bool is_to_slow_down(float dt_s) const;
  bool is_too_fast(float dt_s) const;
  float regulate(float dt_s);
  void watch(bool has_edges, float dt_s);
  bool is_stalled(bool has_edges, float dt_s);
  bool runs_away(float dt_s);

  MinimumJerk set_point_;
  Pid pid_;
  float filter_weight_;  // of the newest speed
  RecentSpeed recent_;
  RecentRequest recent_request_;
  float speed_ticks_s_ = 0.0f;
  float outdated_ticks_s_ = 0.0f;  // the part of speed_ticks_s_ that the PID ignores: the set-point has dropped it
  uint8_t braked_turns_ = 0;       // how long the PID ignores the effect of the wheel's brake
  int16_t pwm_ = 0;
  int8_t direction_ = 1;       // the sign that the edges are given: one channel has none of its own
  float still_s_ = 0.0f;       // since the last edge, and since it was driven: a wheel may roll before its first edge
  bool has_stood_ = true;      // since it was last driven: a rolling wheel is then turned from outside
  float waited_s_ = 0.0f;      // for a standstill, to reverse
  float blind_s_ = 0.0f;       // driven without an edge
  float strained_s_ = 0.0f;    // the same with a high PWM
  float over_s_ = 0.0f;        // too fast
  float peak_ticks_s_ = 0.0f;  // the highest speed meanwhile
  WheelFault fault_ = WheelFault::kNone;
};

}  // namespace hostlink
