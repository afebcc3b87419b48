// The robot's numbers (docs/robot.md#numbers): the fallback where the host has no parameter of that name.
#pragma once

#include <stdint.h>

namespace hostlink {

const float kWheelRadiusM = 0.045f;
const float kWheelSeparationM = 0.210f;  // wheel to wheel
const float kTicksPerTurn = 230.4f;
const float kTicksPerEdge = 0.5f;  // an encoder has a rising and a falling edge a tick
const float kTopSpeedTicksS = 280.0f;

const int16_t kPwmMax = 4095;    // 12 bit
const int16_t kPwmNothing = 10;  // up to here the motor is off
const int16_t kPwmLeast = 700;   // the least that turns a wheel

// How the motors are mounted. The paper's right one is mirrored: it rolls forwards with DIR LOW. The first drive on
// blocks finds a wrong one (../../README.md).
const bool kIsReversedLeft = false;
const bool kIsReversedRight = true;

const float kFilterWeight = 0.1f;             // of the newest speed
const float kSecondsPerTick = 0.018f;         // of minimum jerk, for each tick/s of change
const float kSlowerSecondsPerTick = 0.0009f;  // the same where the set-point goes towards zero
const float kOutdatedShare = 0.05f;           // of the set-point: below it, the filter has forgotten the higher speed
const float kSlowerFactor = 1.15f;            // of the set-point: until then, from here a wheel brakes,
const uint8_t kBrakedTurns = 6;               // until a wheel that was braked is as fast as its PWM makes it
const float kTooFastFactor = 1.05f;           // else of the requested speed, and so much more,
const float kTooFastTicksS = 2.0f;            // whatever the PID computes
const float kNothingTicksS = 0.001f;          // a set-point of less is zero: rounding must not decide a sign
const float kStandingS = 0.1f;                // braked and without an edge: a wheel has come to rest, or all but
const float kRestS = 5.0f;                    // from a zero to rest; a wheel that is slower runs away

const int16_t kHighPwm = 2048;       // turns any wheel that is free
const float kStalledS = 0.5f;        // with a high PWM and no edge
const float kBlindS = 5.0f;          // with any PWM and no edge
const float kRunawayFactor = 1.1f;   // too fast, although it has braked since 1.05: by so much,
const float kRunawayTicksS = 20.0f;  // and by so much,
const float kRunawayS = 0.5f;        // the least duration
const float kSlowingFactor = 0.9f;   // without having slowed to this share of its peak

const uint32_t kLoopUs = 33333;   // 30 Hz
const uint8_t kPublishEvery = 3;  // turns: 10 Hz
const uint32_t kCommandTimeoutMs = 500;
const uint32_t kParameterTimeoutMs = 1000;

// Of the divider before the battery's input: (R1 + R2) / R2, R2 to ground; 4.9 for 39 and 10 kOhm. 0: it is not wired.
const float kBatteryDivider = 0.0f;
const float kBatteryLowV = 10.5f;  // three cells of a LiPo at 3.5 V, six of lead at 1.75 V
const float kNotMeasured = __builtin_nanf("");

struct Gains {
  float kp;
  float ki;
  float kd;
  float feedback;
};

inline Gains make_gains(float kp, float ki, float kd, float feedback) {
  Gains gains = {kp, ki, kd, feedback};
  return gains;
}

const float kFeedback = 0.05f;
const float kFeedbackWashoutS = 1.0f;  // how fast Feedback::kWashedOut fades

// What of the last output the PID subtracts from its error (docs/robot.md#equations).
enum class Feedback : uint8_t {
  kWashedOut,  // its changes: a steady output costs no speed
  kPaper,      // all of it: the integral then keeps every speed 5 % below the request
};

inline Gains left_gains() { return make_gains(23.0f, 36.0f, 0.1f, kFeedback); }  // table 1 of the paper
inline Gains right_gains() { return make_gains(24.0f, 35.0f, 0.1f, kFeedback); }

// How quickly the control goes to a new speed.
struct ControlProfile {
  Gains left;
  Gains right;
  float seconds_per_tick;         // as kSecondsPerTick
  float slower_seconds_per_tick;  // as kSlowerSecondsPerTick
  float filter_weight;            // as kFilterWeight
};

inline ControlProfile paper_profile() {
  ControlProfile profile = {left_gains(), right_gains(), kSecondsPerTick, kSlowerSecondsPerTick, kFilterWeight};
  return profile;
}

inline float battery_volts(uint32_t counts, uint32_t full_counts, float reference_v, float divider) {
  if (divider <= 0.0f) return kNotMeasured;
  return static_cast<float>(counts) / static_cast<float>(full_counts) * reference_v * divider;
}

inline float clamp(float value, float low, float high) {  // Arduino's macros evaluate their arguments twice
  return value < low ? low : (value > high ? high : value);
}

}  // namespace hostlink
