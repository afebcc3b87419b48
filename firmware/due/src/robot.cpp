#include "robot.h"

#include "messages.h"
#include "text.h"

namespace hostlink {

namespace {

using ros::FlashText;
using ros::Level;
using ros::Size;

const size_t kFloatsMax = 8;  // of one parameter
const float kMostGain = 1e6f;
const uint32_t kTroubleIntervalMs = 10000;
const float kLongestStepS = 0.2f;  // a loop that was interrupted does not integrate the time that it missed

enum class Use : uint8_t { kRadius, kSeparation, kTicks, kLeftGains, kRightGains, kTopSpeed, kBatteryLow };

// Parameters that the robot requests from the host: how many numbers, and their range.
struct Parameter {
  const char* name;
  Use use;
  uint8_t least;
  uint8_t most;
  float low;
  float high;
};

const Parameter kParameters[] = {
    {"wheel_radius", Use::kRadius, 1, 2, 0.005f, 0.5f},         // metres
    {"wheel_separation", Use::kSeparation, 1, 1, 0.02f, 5.0f},  // metres, wheel to wheel
    {"ticks_per_turn", Use::kTicks, 1, 2, 1.0f, 100000.0f},     // of the wheel
    {"gains_left", Use::kLeftGains, 3, 3, 0.0f, kMostGain},     // Kp, Ki, Kd
    {"gains_right", Use::kRightGains, 3, 3, 0.0f, kMostGain},
    {"top_speed", Use::kTopSpeed, 1, 1, 1.0f, kTopSpeedTicksS},  // ticks/s
    {"battery_low", Use::kBatteryLow, 1, 1, 0.0f, 60.0f},        // V
};
const uint8_t kParameterCount = sizeof kParameters / sizeof kParameters[0];

bool is_gain(float value) { return value >= 0.0f && value <= kMostGain; }

Gains read_gains(const uint8_t* payload) {
  return make_gains(read_float64(payload), read_float64(payload + kFloat64Bytes),
                    read_float64(payload + 2 * kFloat64Bytes), kFeedback);
}

}  // namespace

Robot::Robot(Hal& hal, const char* name, ros::Retry retry, Feedback feedback, const ControlProfile& profile)
    : hal_(hal),
      node_(hal, retry),
      odometry_("odometry", FlashText(kPose2DType), FlashText(kPose2DMd5)),
      plot_("plot_data", FlashText(kTwistType), FlashText(kTwistMd5)),
      velocity_("velocity_commands", FlashText(kTwistType), FlashText(kTwistMd5), Size::exactly(kTwistBytes),
                &Robot::receive_velocity, this),
      reset_("reset_odometry", FlashText(kEmptyType), FlashText(kEmptyMd5), Size::exactly(0), &Robot::receive_reset,
             this),
      left_gains_("pid_tune_l", FlashText(kVector3Type), FlashText(kVector3Md5), Size::exactly(kVector3Bytes),
                  &Robot::receive_left_gains, this),
      right_gains_("pid_tune_r", FlashText(kVector3Type), FlashText(kVector3Md5), Size::exactly(kVector3Bytes),
                   &Robot::receive_right_gains, this),
      left_(profile.left, feedback, profile),
      right_(profile.right, feedback, profile) {
  node_.setNamespace(name);
}

void Robot::setup() {
  node_.advertise(odometry_);
  node_.advertise(plot_);
  node_.subscribe(velocity_);
  node_.subscribe(reset_);
  node_.subscribe(left_gains_);
  node_.subscribe(right_gains_);
  report_.advertise(node_);
  hal_.drive(0, 0);
  hal_.edges(left_edges_, right_edges_);
  turned_at_us_ = due_since_us_ = hal_.micros();
}

uint32_t Robot::loop() {
  const uint32_t wait_ms = node_.spin();
  guard();
  if (wait_ms > 0) return wait_ms;
  const uint32_t now_us = hal_.micros();
  if (now_us - due_since_us_ < kLoopUs) return 0;
  const uint32_t late_us = now_us - due_since_us_ - kLoopUs;
  // A steady rate. Missed turns are not repeated, and no turn is shorter than half a period.
  due_since_us_ = late_us < kLoopUs / 2 ? due_since_us_ + kLoopUs : now_us;
  const float passed_s = static_cast<float>(now_us - turned_at_us_) * 1e-6f;
  turned_at_us_ = now_us;
  turn(passed_s < kLongestStepS ? passed_s : kLongestStepS);
  return 0;
}

uint32_t Robot::turn_due_in_us() {
  const uint32_t passed_us = hal_.micros() - due_since_us_;
  return passed_us < kLoopUs ? kLoopUs - passed_us : 0;
}

// Runs on each pass, independent of parser and control: without a driver nothing moves.
void Robot::guard() {
  if (!is_commanded_) return;
  if (!node_.is_configured()) {
    stop();
  } else if (hal_.milliseconds() - commanded_at_ms_ > kCommandTimeoutMs) {
    stop();
    raise(Error::kNoCommand);
    node_.log(Level::kWarn, Text().add("no command for ").add(kCommandTimeoutMs).add(" ms: stopped").chars());
  }
}

void Robot::turn(float dt_s) {
  greet();
  uint32_t left_edges = 0;
  uint32_t right_edges = 0;
  hal_.edges(left_edges, right_edges);
  const float left_ticks = left_.step(left_edges - left_edges_, dt_s);
  const float right_ticks = right_.step(right_edges - right_edges_, dt_s);
  left_edges_ = left_edges;
  right_edges_ = right_edges;
  watch();
  if (!is_faulted_) hal_.drive(left_.pwm(), right_.pwm());
  pose_ = drive_.integrate(pose_, left_ticks, right_ticks);
  if (++turns_ == kPublishEvery) {
    turns_ = 0;
    publish();
    raise_faults();
    report_.publish(node_, hal_.battery_v(), hal_.milliseconds());
    log_trouble();
  }
}

// A wheel that does not follow its command stops both wheels, with one line in the log, until a zero has arrived and
void Robot::watch() {
  if (is_faulted_) {
    if (!has_zero_ || !left_.stands() || !right_.stands()) return;
    is_faulted_ = false;
    left_.forgive();
    right_.forgive();
  }
  const bool has_left = log_fault(left_, "left");
  const bool has_right = log_fault(right_, "right");
  if (!has_left && !has_right) return;
  is_faulted_ = true;
  has_zero_ = false;
  stop();
}

bool Robot::log_fault(const Wheel& wheel, const char* side) {
  if (wheel.fault() == WheelFault::kNone) return false;
  Text text;
  text.add(side);
  if (wheel.fault() == WheelFault::kStalled) {
    text.add(" wheel stalled: no edge at PWM ").add(static_cast<int32_t>(wheel.pwm()));
  } else {
    text.add(" wheel runs away: ").add(wheel.speed_ticks_s(), 0).add(" of ");
    text.add(wheel.set_point_ticks_s(), 0).add(" ticks/s");
  }
  node_.log(Level::kError, text.add("; off until a zero").chars());
  return true;
}

// While the wheel is off.
void Robot::raise_faults() {
  const WheelFault left = left_.fault();
  const WheelFault right = right_.fault();
  if (left != WheelFault::kNone) raise(left == WheelFault::kStalled ? Error::kLeftStalled : Error::kLeftRunaway);
  if (right != WheelFault::kNone) raise(right == WheelFault::kStalled ? Error::kRightStalled : Error::kRightRunaway);
}

void Robot::stop() {
  is_commanded_ = false;
  left_.stop_at_once();
  right_.stop_at_once();
  hal_.drive(0, 0);
}

// Log the configuration once, and request the parameters one after the other without waiting.
void Robot::greet() {
  const bool is_configured = node_.is_configured();
  if (is_configured && !was_configured_) {
    node_.log(Level::kInfo, "robot is ready");
    if (hal_.was_hung() && !was_hung_logged_) {
      was_hung_logged_ = true;
      raise(Error::kHung);
      node_.log(Level::kError, "started by its watchdog: the loop had not turned for 500 ms");
    }
    requested_ = 1;
    node_.request_parameter(kParameters[0].name, &Robot::receive_parameter, this);
    requested_at_ms_ = hal_.milliseconds();
  } else if (is_configured && requested_ != 0 && hal_.milliseconds() - requested_at_ms_ > kParameterTimeoutMs) {
    // The constants apply. An answer does not name its parameter, so a late answer must not be used for the next one.
    node_.log(Level::kWarn,
              Text().add("no answer to ").add(kParameters[requested_ - 1].name).add(": no more questions").chars());
    requested_ = 0;
  }
  was_configured_ = is_configured;
}

// An answer without a number: the host does not have the parameter, and the present value stays.
void Robot::use_parameter(const float* values, size_t count) {
  if (requested_ == 0) return;
  if (count > 0 && !apply_values(values, count)) refuse_parameter();
  requested_ = requested_ < kParameterCount ? static_cast<uint8_t>(requested_ + 1) : static_cast<uint8_t>(0);
  if (requested_ == 0) {
    log_geometry();
    return;
  }
  node_.request_parameter(kParameters[requested_ - 1].name, &Robot::receive_parameter, this);
  requested_at_ms_ = hal_.milliseconds();
}

// Returns false for an invalid value. One number is for both wheels; two are for the left and the right wheel.
bool Robot::apply_values(const float* values, size_t count) {
  const Parameter& parameter = kParameters[requested_ - 1];
  if (count < parameter.least || count > parameter.most) return false;
  for (size_t i = 0; i < count; ++i) {
    if (!(values[i] >= parameter.low && values[i] <= parameter.high)) return false;  // NaN is not
  }
  const float right = values[count - 1];
  switch (parameter.use) {
    case Use::kRadius:
      drive_.set_wheel_radii(values[0], right);
      break;
    case Use::kTicks:
      drive_.set_ticks_per_turn(values[0], right);
      break;
    case Use::kSeparation:
      drive_.set_separation(values[0]);
      break;
    case Use::kBatteryLow:
      report_.battery().set_low_v(values[0]);
      return true;
    case Use::kTopSpeed:
      drive_.set_top_speed(values[0]);
      return true;
    default:
      tune(parameter.use == Use::kLeftGains ? left_ : right_, make_gains(values[0], values[1], values[2], kFeedback));
      return true;
  }
  has_new_geometry_ = true;
  return true;
}

void Robot::refuse_parameter() {
  const Parameter& parameter = kParameters[requested_ - 1];
  raise(Error::kRefused);
  Text text;
  text.add(parameter.name).add(" refused: ").add(static_cast<uint32_t>(parameter.least));
  if (parameter.most > parameter.least) text.add(" or ").add(static_cast<uint32_t>(parameter.most));
  text.add(parameter.most > 1 ? " numbers from " : " number from ")
      .add(parameter.low, 3)
      .add(" to ")
      .add(parameter.high, 1);
  node_.log(Level::kWarn, text.chars());
}

// Two lines, because the host's log cuts a line at 64 characters. Each in its own function, to save stack.
void Robot::log_geometry() {
  if (!has_new_geometry_) return;
  has_new_geometry_ = false;
  log_radii();
  log_ticks();
}

void Robot::log_radii() {
  Text text;
  text.add("wheel radius ").add(drive_.left().radius_m * 1000.0f, 3).add(" and ");
  text.add(drive_.right().radius_m * 1000.0f, 3).add(" mm, ").add(drive_.separation_m() * 1000.0f, 2).add(" mm apart");
  node_.log(Level::kInfo, text.chars());
}

void Robot::log_ticks() {
  Text text;
  text.add("ticks a turn ").add(drive_.left().ticks_per_turn, 3).add(" and ").add(drive_.right().ticks_per_turn, 3);
  node_.log(Level::kInfo, text.chars());
}

void Robot::publish() {
  uint8_t pose[kPose2DBytes];
  write_float64(pose, static_cast<float>(pose_.x_m));
  write_float64(pose + kFloat64Bytes, static_cast<float>(pose_.y_m));
  write_float64(pose + 2 * kFloat64Bytes, static_cast<float>(pose_.theta_rad));
  odometry_.publish(pose, sizeof pose);
  const float plot[6] = {left_.speed_ticks_s(),     right_.speed_ticks_s(),     static_cast<float>(left_.pwm()),
                         left_.set_point_ticks_s(), right_.set_point_ticks_s(), static_cast<float>(right_.pwm())};
  uint8_t twist[kTwistBytes];
  for (size_t i = 0; i < 6; ++i) write_float64(twist + i * kFloat64Bytes, plot[i]);
  plot_.publish(twist, sizeof twist);
}

void Robot::receive_velocity(void* self, const uint8_t* payload, size_t) {
  Robot& robot = *static_cast<Robot*>(self);
  float left_ticks_s = 0.0f;
  float right_ticks_s = 0.0f;
  robot.drive_.wheel_speeds(read_float64(payload), read_float64(payload + 5 * kFloat64Bytes), left_ticks_s,
                            right_ticks_s);
  // Check the ticks, not the metres: a velocity may be finite while its ticks are not. Scaling those gives NaN.
  const bool is_number = left_ticks_s - left_ticks_s == 0.0f && right_ticks_s - right_ticks_s == 0.0f;
  if (!is_number) {
    robot.stop();
    robot.raise(Error::kNoNumber);
    robot.node_.log(Level::kError, "a velocity that is no number: stopped");
    return;
  }
  if (left_ticks_s == 0.0f && right_ticks_s == 0.0f) {
    robot.has_zero_ = true;
    robot.stop();  // now, not in the next turn; a stopped robot needs no watchdog
    return;
  }
  if (robot.is_faulted_) return;
  robot.left_.aim(left_ticks_s);
  robot.right_.aim(right_ticks_s);
  robot.hal_.drive(robot.left_.pwm_now(), robot.right_.pwm_now());  // a wheel that must reverse brakes now
  robot.is_commanded_ = true;
  robot.commanded_at_ms_ = robot.hal_.milliseconds();
}

void Robot::receive_reset(void* self, const uint8_t*, size_t) {
  const Pose origin = {0.0, 0.0, 0.0};
  static_cast<Robot*>(self)->pose_ = origin;
}

void Robot::receive_left_gains(void* self, const uint8_t* payload, size_t) {
  Robot& robot = *static_cast<Robot*>(self);
  robot.tune(robot.left_, read_gains(payload));
}

void Robot::receive_right_gains(void* self, const uint8_t* payload, size_t) {
  Robot& robot = *static_cast<Robot*>(self);
  robot.tune(robot.right_, read_gains(payload));
}

// A negative gain or NaN would leave the wheel without control.
void Robot::tune(Wheel& wheel, const Gains& gains) {
  const char* const side = &wheel == &left_ ? "left" : "right";
  if (!is_gain(gains.kp) || !is_gain(gains.ki) || !is_gain(gains.kd)) {
    raise(Error::kRefused);
    node_.log(Level::kWarn, Text().add(side).add(" gains refused: each is 0 or more").chars());
    return;
  }
  wheel.pid().tune(gains);
  Text text;
  text.add(side).add(" Kp ").add(gains.kp, 2).add(" Ki ").add(gains.ki, 2).add(" Kd ").add(gains.kd, 3);
  node_.log(Level::kInfo, text.chars());
}

// Report the errors of the link when there are new ones, at most every ten seconds.
void Robot::log_trouble() {
  const uint32_t trouble = node_.dropped_from_host() + node_.refused() + node_.dropped_to_host();
  const bool is_new = trouble != logged_trouble_ && hal_.milliseconds() - logged_trouble_at_ms_ > kTroubleIntervalMs;
  if (!is_new || !node_.is_configured()) return;
  logged_trouble_ = trouble;
  logged_trouble_at_ms_ = hal_.milliseconds();
  Text text;
  text.add("link: false starts of frames ").add(node_.dropped_from_host());
  text.add(", frames refused ").add(node_.refused()).add(", not sent ").add(node_.dropped_to_host());
  node_.log(Level::kWarn, text.chars());
}

void Robot::receive_parameter(void* self, ros::ParameterAnswer& answer) {
  float values[kFloatsMax];
  const size_t count = answer.numbers(values, kFloatsMax);
  static_cast<Robot*>(self)->use_parameter(values, count < kFloatsMax ? count : kFloatsMax);
}

}  // namespace hostlink
