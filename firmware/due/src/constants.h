// The robot's numbers (docs/paper-robot.md#numbers): used where the host has no parameter of that name.
#pragma once

#include <stdint.h>

namespace hostlink {

const float kWheelRadiusM = 0.045f;
const float kWheelSeparationM = 0.210f;  // wheel to wheel
const float kTicksPerTurn = 230.4f;
const float kTicksPerEdge = 0.5f;  // an encoder has a rising and a falling edge a tick
const float kTopSpeedTicksS = 280.0f;

const int16_t kPwmMax = 4095;    // 12 bit
const int16_t kPwmNothing = 10;  // at or below this PWM the motor is off
const int16_t kPwmLeast = 700;   // the lowest PWM that turns a wheel

// Mounting of the motors. The paper's right motor is mirrored: it rolls forwards with DIR LOW. The first drive on
// blocks shows a wrong setting (docs/build-robot.md).
const bool kIsReversedLeft = false;
const bool kIsReversedRight = true;

const float kFilterWeight = 0.1f;             // of the newest speed
const float kSecondsPerTick = 0.018f;         // of minimum jerk, for each tick/s of change
const float kSlowerSecondsPerTick = 0.0009f;  // the same for a set-point that decreases towards zero
const float kOutdatedShare = 0.05f;           // of the set-point: below it, the filter has forgotten the higher speed
const float kSlowerFactor = 1.15f;            // of the set-point: above it a wheel brakes until then,
const uint8_t kBrakedTurns = 6;               // until a braked wheel is as fast as its PWM makes it
const float kTooFastFactor = 1.05f;           // otherwise of the requested speed, plus this,
const float kTooFastTicksS = 2.0f;            // independent of the PID's output
const float kNothingTicksS = 0.001f;          // a smaller set-point is zero, so that rounding does not decide a sign
const float kStandingS = 0.1f;                // braked and without an edge: the wheel has come to rest, or nearly
const float kRestS = 5.0f;                    // from a zero to rest; a wheel that takes longer runs away

const int16_t kHighPwm = 2048;       // turns any wheel that is not blocked
const float kStalledS = 0.5f;        // with a high PWM and no edge
const float kBlindS = 5.0f;          // with any PWM and no edge
const float kRunawayFactor = 1.1f;   // too fast although it has braked since 1.05: by this factor,
const float kRunawayTicksS = 20.0f;  // and by this amount,
const float kRunawayS = 0.5f;        // the least duration
const float kSlowingFactor = 0.9f;   // without having slowed to this share of its peak

const uint32_t kLoopUs = 33333;   // 30 Hz
const uint8_t kPublishEvery = 3;  // turns: 10 Hz
const uint32_t kCommandTimeoutMs = 500;
const uint32_t kParameterTimeoutMs = 1000;

// Factor of the voltage divider at the battery input: (R1 + R2) / R2, R2 to ground; 4.9 for 39 and 10 kOhm. 0: none.
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

// Which part of the last output the PID subtracts from its error (docs/paper-robot.md#equations).
enum class Feedback : uint8_t {
  kWashedOut,  // only its changes: a steady output costs no speed
  kPaper,      // the whole output: the integral then keeps every speed 5 % below the request
};

inline Gains left_gains() { return make_gains(23.0f, 36.0f, 0.1f, kFeedback); }  // table 1 of the paper
inline Gains right_gains() { return make_gains(24.0f, 35.0f, 0.1f, kFeedback); }

// How fast the control follows a new speed.
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
