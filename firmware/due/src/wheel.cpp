#include "wheel.h"

namespace hostlink {

namespace {

const float kCountTicks = 0.49f;  // almost an edge: the possible error of a count

float magnitude(float value) { return value < 0.0f ? -value : value; }

// Times are sums of turns: half a turn less, so that rounding does not decide.
bool has_lasted(float time_s, float wanted_s) { return time_s > wanted_s - static_cast<float>(kLoopUs) * 0.5e-6f; }

// Share of its distance that a minimum-jerk curve has travelled after the share s of its time.
float travelled(float way, float s) { return way * s * s * s * (10.0f + s * (-15.0f + 6.0f * s)); }

}  // namespace

// The slope of each curve is 30 s^2 (1-s)^2 / its seconds per tick, independent of its distance: a curve that starts at
// s has the slope of the set-point there. Its distance is what is left, divided by the share that a curve has left at
// s.
void MinimumJerk::aim(float target) {
  if (target == target_) return;
  if (target == 0.0f || (target < 0.0f ? value_ > 0.0f : value_ < 0.0f)) stop_at_once();
  const float rest = target - value_;
  const bool goes_on =
      rest * (target_ - from_) > 0.0f;  // use the whole distance: otherwise rounding decides what is left at its end
  const float s = goes_on ? rising_phase() : 0.0f;
  const float way = rest / (1.0f - travelled(1.0f, s));
  from_ = value_ - travelled(way, s);
  target_ = target;
  length_s_ = magnitude(way) * (magnitude(target) < magnitude(value_) ? slower_seconds_per_tick_ : seconds_per_tick_);
  elapsed_s_ = s * length_s_;
}

// The phase in the first half of a curve that has the present slope. The second half has the same slopes but is slower.
float MinimumJerk::rising_phase() const {
  if (!(elapsed_s_ < length_s_)) return 0.0f;
  const float s = elapsed_s_ / length_s_;
  return s < 0.5f ? s : 1.0f - s;
}

void MinimumJerk::stop_at_once() {
  value_ = target_ = from_ = 0.0f;
  elapsed_s_ = length_s_ = 0.0f;
}

void MinimumJerk::begin_at_zero() {
  const float target = target_;
  stop_at_once();
  aim(target);
}

float MinimumJerk::step(float dt_s) {
  elapsed_s_ += dt_s;
  if (!(elapsed_s_ < length_s_)) {  // also with a distance of zero: no division by zero
    value_ = target_;
    elapsed_s_ = length_s_;
    return value_;
  }
  value_ = from_ + travelled(target_ - from_, elapsed_s_ / length_s_);
  return value_;
}

float Pid::step(float wanted_ticks_s, float measured_ticks_s, float dt_s, float low, float high) {
  const float error = wanted_ticks_s - measured_ticks_s - gains_.feedback * fed_back_ticks_s(dt_s);
  const float integral = integral_ + error * dt_s;
  const float derivative = (error - previous_error_) / dt_s;
  const float free = gains_.kp * error + gains_.ki * integral + gains_.kd * derivative;
  output_ = clamp(free, low, high);
  const bool winds_up = free != output_ && (free > 0.0f) == (error > 0.0f);
  if (!winds_up) integral_ = integral;
  previous_error_ = error;
  return output_;
}

// The last output as a speed; with kWashedOut, minus its mean over the last second or so.
float Pid::fed_back_ticks_s(float dt_s) {
  const float last_ticks_s = output_ / static_cast<float>(kPwmMax) * kTopSpeedTicksS;
  if (feedback_ == Feedback::kPaper) return last_ticks_s;
  const float quick_ticks_s = last_ticks_s - steady_ticks_s_;
  steady_ticks_s_ += quick_ticks_s * dt_s / (kFeedbackWashoutS + dt_s);
  return quick_ticks_s;
}

void Pid::reset() { output_ = steady_ticks_s_ = integral_ = previous_error_ = 0.0f; }

int16_t motor_output(float wanted) {
  const float size = magnitude(wanted);
  if (!(size > static_cast<float>(kPwmNothing))) return 0;  // NaN compares false
  const float bounded = clamp(size, static_cast<float>(kPwmLeast), static_cast<float>(kPwmMax));
  const int16_t pwm = static_cast<int16_t>(bounded + 0.5f);
  return wanted < 0.0f ? static_cast<int16_t>(-pwm) : pwm;
}

void RecentSpeed::add(float ticks, float dt_s) {
  ticks_[at_] = ticks;
  seconds_[at_] = dt_s;
  at_ = static_cast<uint8_t>((at_ + 1) % kTurns);
}

float RecentSpeed::ticks() const {
  float sum = 0.0f;
  for (uint8_t i = 0; i < kTurns; ++i) sum += ticks_[i];
  return sum;
}

float RecentSpeed::seconds() const {
  float sum = 0.0f;
  for (uint8_t i = 0; i < kTurns; ++i) sum += seconds_[i];
  return sum;
}

void RecentRequest::add(float ticks_s) {
  ticks_s_[at_] = ticks_s;
  at_ = static_cast<uint8_t>((at_ + 1) % kTurns);
}

float RecentRequest::most() const {
  float most = 0.0f;
  for (uint8_t i = 0; i < kTurns; ++i) most = ticks_s_[i] > most ? ticks_s_[i] : most;
  return most;
}

float Wheel::step(uint32_t edges, float dt_s) {
  const float ticks = static_cast<float>(edges) * kTicksPerEdge;
  const float rolled = static_cast<float>(direction_) * ticks;
  speed_ticks_s_ += filter_weight_ * (rolled / dt_s - speed_ticks_s_);
  recent_.add(ticks, dt_s);
  still_s_ = edges == 0 && pwm_ == 0 ? clamp(still_s_ + dt_s, 0.0f, 1.0f) : 0.0f;
  pwm_ = motor_output(regulate(dt_s));
  has_stood_ = pwm_ == 0 && (has_stood_ || stands());
  watch(edges != 0, dt_s);
  return rolled;
}

bool Wheel::stands() const { return has_lasted(still_s_, kStandingS); }

float Wheel::requested_ticks_s() const {
  const float value = magnitude(set_point_.value());
  const float target = magnitude(set_point_.target());
  return value > target ? value : target;
}

// The filter and the integral lag by a third of a second and more, so they follow a decreasing set-point late and do
// not notice the braking. Without this the wheel is braked to a standstill, driven too fast and braked again while the
// command lasts.
void Wheel::forget(float before, float wanted) {
  outdated_ticks_s_ -= filter_weight_ * outdated_ticks_s_;
  if (magnitude(wanted) < magnitude(before)) {
    outdated_ticks_s_ += before - wanted;
    pid_.scale_integral(wanted / before);
  }
  if (braked_turns_ > 0) {
    --braked_turns_;
    outdated_ticks_s_ = speed_ticks_s_ - wanted;
  }
}

// While the filter still has the higher speed.
bool Wheel::is_to_slow_down(float dt_s) const {
  const float wanted_ticks_s = magnitude(set_point_.value());
  return magnitude(outdated_ticks_s_) > kOutdatedShare * wanted_ticks_s &&
         recent_.last_ticks() > kSlowerFactor * wanted_ticks_s * dt_s + kCountTicks;
}

// The window lags by a tenth of a second. The last turn ends the braking before the wheel has stopped.
bool Wheel::is_too_fast(float dt_s) const {
  const float allowed_ticks_s = kTooFastFactor * recent_request_.most() + kTooFastTicksS;
  return recent_.ticks() > allowed_ticks_s * recent_.seconds() + kCountTicks &&
         recent_.last_ticks() + kCountTicks > allowed_ticks_s * dt_s;
}

// PWM of the motor, by the table of the class.
float Wheel::regulate(float dt_s) {
  const float before = set_point_.value();
  const float wanted = set_point_.step(dt_s);
  forget(before, wanted);
  recent_request_.add(requested_ticks_s());
  const float along = wanted * static_cast<float>(direction_);
  const bool is_reversal = along < -kNothingTicksS;
  waited_s_ = along < kNothingTicksS && set_point_.target() != 0.0f ? waited_s_ + dt_s : 0.0f;
  if (along < kNothingTicksS) {
    pid_.reset();
    outdated_ticks_s_ = 0.0f;
    braked_turns_ = 0;
    if (stands()) speed_ticks_s_ = 0.0f;  // do not wait for the filter
    if (is_reversal) set_point_.begin_at_zero();
    if (is_reversal && stands()) direction_ = static_cast<int8_t>(-direction_);
    return 0.0f;
  }
  const float full = static_cast<float>(kPwmMax);
  const float output = pid_.step(wanted, speed_ticks_s_ - outdated_ticks_s_, dt_s, direction_ > 0 ? 0.0f : -full,
                                 direction_ > 0 ? full : 0.0f);
  const bool is_over = is_too_fast(dt_s);
  if (!is_over && !is_to_slow_down(dt_s)) return output;
  if (is_over) pid_.scale_integral(recent_request_.most() * recent_.seconds() / recent_.ticks());
  braked_turns_ = kBrakedTurns;
  return 0.0f;
}

void Wheel::watch(bool has_edges, float dt_s) {
  const bool stalled = is_stalled(has_edges, dt_s);
  const bool ran_away = runs_away(dt_s);
  if (fault_ != WheelFault::kNone) return;
  if (stalled) fault_ = WheelFault::kStalled;
  if (ran_away) fault_ = WheelFault::kRunaway;
}

bool Wheel::is_stalled(bool has_edges, float dt_s) {
  const bool is_blind = pwm_ != 0 && !has_edges;
  const bool is_strained = is_blind && (pwm_ >= kHighPwm || pwm_ <= -kHighPwm);
  blind_s_ = is_blind ? blind_s_ + dt_s : 0.0f;
  strained_s_ = is_strained ? strained_s_ + dt_s : 0.0f;
  return has_lasted(strained_s_, kStalledS) || has_lasted(blind_s_, kBlindS);
}

// A wheel that coasts or has a lower set-point slows down; a wheel that is driven from outside does not.
bool Wheel::runs_away(float dt_s) {
  if (has_lasted(waited_s_, kRestS)) return true;
  const float requested = recent_request_.most();
  const float speed = recent_.ticks() / recent_.seconds();
  if (has_stood_ || speed <= requested + kRunawayTicksS || speed <= requested * kRunawayFactor) {
    over_s_ = peak_ticks_s_ = 0.0f;
    return false;
  }
  over_s_ += dt_s;
  peak_ticks_s_ = speed > peak_ticks_s_ ? speed : peak_ticks_s_;
  if (!has_lasted(over_s_, kRunawayS)) return false;
  const bool slows_down = speed <= peak_ticks_s_ * kSlowingFactor;
  over_s_ = peak_ticks_s_ = 0.0f;
  return !slows_down;
}

void Wheel::forgive() {
  fault_ = WheelFault::kNone;
  waited_s_ = blind_s_ = strained_s_ = over_s_ = peak_ticks_s_ = 0.0f;
}

}  // namespace hostlink
