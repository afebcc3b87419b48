// The Due's firmware for Python's ctypes: its classes by pointer, and a Hal whose inputs are all set by the test.
#include <stdint.h>
#include <string.h>

#include <deque>
#include <string>
#include <vector>

#include "../due/src/drive.h"
#include "../due/src/messages.h"
#include "../due/src/robot.h"
#include "../due/src/wheel.h"

using namespace hostlink;
using ros::FlashText;

namespace {

struct TestHal : public Hal {
  uint64_t now_us = 0;
  std::deque<uint8_t> from_host;
  std::string to_host;
  size_t room = SIZE_MAX;  // what write() accepts in total until it is set again
  int16_t left_pwm = 0;
  int16_t right_pwm = 0;
  uint32_t left_edges = 0;
  uint32_t right_edges = 0;
  float volts = kNotMeasured;

  uint32_t milliseconds() override { return static_cast<uint32_t>(now_us / 1000); }
  uint32_t micros() override { return static_cast<uint32_t>(now_us); }
  int read() override {
    if (from_host.empty()) return -1;
    const int byte = from_host.front();
    from_host.pop_front();
    return byte;
  }
  size_t write(const uint8_t* data, size_t size) override {
    const size_t taken = size < room ? size : room;
    to_host.append(reinterpret_cast<const char*>(data), taken);
    room -= taken;
    return taken;
  }
  void drive(int16_t left, int16_t right) override {
    left_pwm = left;
    right_pwm = right;
  }
  void edges(uint32_t& left, uint32_t& right) override {
    left = left_edges;
    right = right_edges;
  }
  float battery_v() override { return volts; }
};

void hear(void* context, const uint8_t* payload, size_t size);

struct TestNode {
  TestHal hal;
  RobotNode node;
  ros::RawPublisher odometry{"/odometry", FlashText(kPose2DType), FlashText("m")};
  ros::RawSubscriber velocity{"/velocity", FlashText(kTwistType), FlashText("m"), ros::Size::exactly(kTwistBytes), hear,
                              this};
  ros::RawSubscriber led{"/led", FlashText("std_msgs/Bool"), FlashText("m"), ros::Size::exactly(1), hear, this};
  std::string heard;  // payloads that the callback received, each after its size in two bytes
  std::vector<float> parameter;
  explicit TestNode(int retry) : node(hal, static_cast<ros::Retry>(retry)) {
    node.advertise(odometry);
    node.subscribe(velocity);
    node.subscribe(led);
  }
};

void hear(void* context, const uint8_t* payload, size_t size) {
  std::string& heard = static_cast<TestNode*>(context)->heard;
  heard.push_back(static_cast<char>(size & 0xFF));
  heard.push_back(static_cast<char>(size >> 8));
  heard.append(reinterpret_cast<const char*>(payload), size);
}

void take_floats(void* context, ros::ParameterAnswer& answer) {
  std::vector<float>& parameter = static_cast<TestNode*>(context)->parameter;
  parameter.resize(answer.numbers(nullptr, 0));
  answer.numbers(parameter.data(), parameter.size());
}

struct TestRobot {
  TestHal hal;
  Robot robot;
  explicit TestRobot(int retry) : robot(hal, "/robot_0/", static_cast<ros::Retry>(retry)) { robot.setup(); }
};

size_t take_all(std::string& from, uint8_t* out, size_t capacity) {
  const size_t size = from.size() < capacity ? from.size() : capacity;
  memcpy(out, from.data(), size);
  from.erase(0, size);
  return size;
}

}  // namespace

extern "C" {

TestNode* node_new(int retry) { return new TestNode(retry); }
void node_delete(TestNode* node) { delete node; }
void node_feed(TestNode* node, const uint8_t* bytes, size_t size) {
  node->hal.from_host.insert(node->hal.from_host.end(), bytes, bytes + size);
}
void node_room(TestNode* node, size_t room) { node->hal.room = room; }
uint32_t node_spin(TestNode* node, uint64_t now_us) {
  node->hal.now_us = now_us;
  return node->node.spin();
}
size_t node_sent(TestNode* node, uint8_t* out, size_t capacity) { return take_all(node->hal.to_host, out, capacity); }
size_t node_heard(TestNode* node, uint8_t* out, size_t capacity) { return take_all(node->heard, out, capacity); }
int node_configured(TestNode* node) { return node->node.is_configured() ? 1 : 0; }
int node_publish(TestNode* node, const uint8_t* bytes, size_t size) {
  return node->odometry.publish(bytes, size) > 0 ? 1 : 0;
}
void node_log(TestNode* node, uint8_t level, const char* text) { node->node.log(static_cast<ros::Level>(level), text); }
void node_ask(TestNode* node, const char* name) { node->node.request_parameter(name, take_floats, node); }
size_t node_parameter(TestNode* node, float* out, size_t capacity) {
  const size_t count = node->parameter.size() < capacity ? node->parameter.size() : capacity;
  for (size_t i = 0; i < count; ++i) out[i] = node->parameter[i];
  return count;
}
uint32_t node_dropped_from_host(TestNode* node) { return node->node.dropped_from_host(); }
uint32_t node_dropped_to_host(TestNode* node) { return node->node.dropped_to_host(); }
uint32_t node_refused(TestNode* node) { return node->node.refused(); }

TestRobot* robot_new(int retry) { return new TestRobot(retry); }
void robot_delete(TestRobot* robot) { delete robot; }
void robot_feed(TestRobot* robot, const uint8_t* bytes, size_t size) {
  robot->hal.from_host.insert(robot->hal.from_host.end(), bytes, bytes + size);
}
void robot_loop(TestRobot* robot, uint64_t now_us, uint32_t left_edges, uint32_t right_edges) {
  robot->hal.now_us = now_us;
  robot->hal.left_edges = left_edges;
  robot->hal.right_edges = right_edges;
  robot->robot.loop();
}
void robot_battery(TestRobot* robot, float volts) { robot->hal.volts = volts; }
float battery_input_v(uint32_t counts, float divider) { return battery_volts(counts, 4095, 3.3f, divider); }
size_t robot_sent(TestRobot* robot, uint8_t* out, size_t capacity) {
  return take_all(robot->hal.to_host, out, capacity);
}
int robot_left_pwm(TestRobot* robot) { return robot->hal.left_pwm; }
int robot_right_pwm(TestRobot* robot) { return robot->hal.right_pwm; }
void robot_pose(TestRobot* robot, double* out) {
  out[0] = robot->robot.pose().x_m;
  out[1] = robot->robot.pose().y_m;
  out[2] = robot->robot.pose().theta_rad;
}

Errors* errors_new() { return new Errors(); }
void errors_delete(Errors* errors) { delete errors; }
void errors_raise(Errors* errors, int number, uint32_t now_ms) { errors->raise(static_cast<Error>(number), now_ms); }
size_t errors_list(Errors* errors, uint8_t* out, uint32_t now_ms) { return errors->list(out, now_ms); }

MinimumJerk* jerk_new() { return new MinimumJerk(); }
void jerk_delete(MinimumJerk* jerk) { delete jerk; }
void jerk_aim(MinimumJerk* jerk, float target) { jerk->aim(target); }
float jerk_step(MinimumJerk* jerk, float dt_s) { return jerk->step(dt_s); }

Pid* pid_new(float kp, float ki, float kd, float feedback) { return new Pid(make_gains(kp, ki, kd, feedback)); }
void pid_delete(Pid* pid) { delete pid; }
float pid_step(Pid* pid, float wanted, float measured, float dt_s) { return pid->step(wanted, measured, dt_s); }

Wheel* wheel_new(int feedback) { return new Wheel(left_gains(), static_cast<Feedback>(feedback)); }
void wheel_delete(Wheel* wheel) { delete wheel; }
void wheel_aim(Wheel* wheel, float ticks_s) { wheel->aim(ticks_s); }
float wheel_step(Wheel* wheel, uint32_t edges, float dt_s) { return wheel->step(edges, dt_s); }
int wheel_pwm(Wheel* wheel) { return wheel->pwm(); }
float wheel_speed(Wheel* wheel) { return wheel->speed_ticks_s(); }
float wheel_set_point(Wheel* wheel) { return wheel->set_point_ticks_s(); }

int pwm_of(float wanted) { return motor_output(wanted); }
Drive* drive_new(float left_m, float right_m, float left_ticks, float right_ticks, float separation_m) {
  Drive* made = new Drive();
  made->set_wheel_radii(left_m, right_m);
  made->set_ticks_per_turn(left_ticks, right_ticks);
  made->set_separation(separation_m);
  return made;
}
void drive_delete(Drive* drive) { delete drive; }
void drive_wheel_speeds(Drive* drive, float linear, float angular, float* out) {
  drive->wheel_speeds(linear, angular, out[0], out[1]);
}
void drive_integrate(Drive* drive, double* pose, float left_ticks, float right_ticks) {
  const Pose from = {pose[0], pose[1], pose[2]};
  const Pose to = drive->integrate(from, left_ticks, right_ticks);
  pose[0] = to.x_m;
  pose[1] = to.y_m;
  pose[2] = to.theta_rad;
}
float from_float64(const uint8_t* bytes) { return read_float64(bytes); }
void to_float64(uint8_t* bytes, float value) { write_float64(bytes, value); }
}
