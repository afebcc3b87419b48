// One wheel: set-point along a minimum-jerk curve, PID with a feedback term, motor output, ticks with their sign.
// No clock and no pin: dt comes in.
#pragma once

#include <stdint.h>

#include "constants.h"

namespace hostlink {

// A set-point that goes from where it is to a target without a jerk. Its slope is at most 1.875 / seconds_per_tick away
// from zero and 1.875 / slower_seconds_per_tick towards zero, and it never passes the target. A further or nearer
// target the same way keeps the slope, so that commands which change ten times a second add up to one motion; one the
// other way begins at zero slope. Before a target of the other sign it is zero at once, and at a target of zero, too.
class MinimumJerk {
 public:
  explicit MinimumJerk(float seconds_per_tick = kSecondsPerTick, float slower_seconds_per_tick = kSlowerSecondsPerTick)
      : seconds_per_tick_(seconds_per_tick), slower_seconds_per_tick_(slower_seconds_per_tick) {}
  void aim(float target);  // the same target again changes nothing
  void stop_at_once();     // be at zero now
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

// e = wanted - measured - feedback * last output, or its changes alone; no winding up against the limit.
class Pid {
 public:
  explicit Pid(const Gains& gains, Feedback feedback = Feedback::kWashedOut) : gains_(gains), feedback_(feedback) {}
  // The output stays within low and high; the original's limits are the motor's.
  float step(float wanted_ticks_s, float measured_ticks_s, float dt_s, float low = -static_cast<float>(kPwmMax),
             float high = static_cast<float>(kPwmMax));
  void reset();
  void scale_integral(float factor) { integral_ *= factor; }  // to what another speed needs
  void tune(const Gains& gains) { gains_ = gains; }
  const Gains& gains() const { return gains_; }

 private:
  float fed_back_ticks_s(float dt_s);

  Gains gains_;
  Feedback feedback_;
  float output_ = 0.0f;
  float steady_ticks_s_ = 0.0f;  // the output's slow part, which is not fed back
  float integral_ = 0.0f;
  float previous_error_ = 0.0f;
};

// Nothing up to 10, at least 700 above, 4095 at the most; what is no number is nothing.
int16_t motor_output(float wanted);

// The mean speed over the last fifth of a second, and the last turn's: the filter of the PID is late by a third of one.
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

// The fastest that was requested in the last 0.3 s: a wheel follows its set-point that much later.
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
  kRunaway,  // far faster than it should be, and not slowing down: not this program drives it
};

// One channel of an encoder has no sign, so the wheel must never roll otherwise than it is driven:
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
//   | against the sign  | stands: braked for 0.1 s, and | the sign changes, then it is driven                       |
//   |                   | no edge meanwhile             |                                                           |
class Wheel {
 public:
  explicit Wheel(const Gains& gains, Feedback feedback = Feedback::kWashedOut,
                 const ControlProfile& profile = paper_profile())
      : set_point_(profile.seconds_per_tick, profile.slower_seconds_per_tick),
        pid_(gains, feedback),
        filter_weight_(profile.filter_weight) {}

  void aim(float ticks_s) { set_point_.aim(ticks_s); }
  void stop_at_once() { set_point_.stop_at_once(); }
  // One turn of the loop with the edges that the encoder counted in it; returns how far the wheel rolled, in ticks.
  // Rising and falling ones count: the edge that a wheel comes back over is then the one that it went over, and a
  // reversal costs nothing. The rising ones alone lie elsewhere on the way back, up to a tick from where they were.
  float step(uint32_t edges, float dt_s);

  int16_t pwm() const { return pwm_; }  // of the last turn
  int16_t pwm_now() const { return set_point_.value() == 0.0f ? static_cast<int16_t>(0) : pwm_; }
  float speed_ticks_s() const { return speed_ticks_s_; }
  float set_point_ticks_s() const { return set_point_.value(); }
  float target_ticks_s() const { return set_point_.target(); }  // of the last command
  bool stands() const;
  WheelFault fault() const { return fault_; }  // stays until it is forgiven
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
  float outdated_ticks_s_ = 0.0f;  // of speed_ticks_s_: what the PID ignores, as the set-point has given it up
  uint8_t braked_turns_ = 0;       // for which the PID ignores what the wheel's brake did
  int16_t pwm_ = 0;
  int8_t direction_ = 1;       // the sign that the edges are given: one channel has none of its own
  float still_s_ = 0.0f;       // since the last edge, and since it was driven: a wheel may roll before it has an edge
  bool has_stood_ = true;      // since it was last driven: what rolls then is rolled by somebody else
  float waited_s_ = 0.0f;      // for a standstill, to reverse
  float blind_s_ = 0.0f;       // driven without an edge
  float strained_s_ = 0.0f;    // the same with a high PWM
  float over_s_ = 0.0f;        // too fast
  float peak_ticks_s_ = 0.0f;  // the fastest that it was meanwhile
  WheelFault fault_ = WheelFault::kNone;
};

}  // namespace hostlink
