// The Due's numbers (docs/paper-robot.md#numbers), natively and on a Cortex-M3: a plain main, so that it runs where
// there is no library.
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "../due/src/drive.h"
#include "../due/src/messages.h"
#include "../due/src/robot.h"
#include "../due/src/wheel.h"
#include "../host/uart_out.h"
#include "../host/uart_ring.h"
#include "../host/world.h"
#include "check.h"

using namespace hostlink;

namespace {

bool is_near(double value, double wanted, double tolerance) { return fabs(value - wanted) <= tolerance; }

void test_motor_output() {
  CHECK(motor_output(0.0f) == 0);
  CHECK(motor_output(10.0f) == 0);
  CHECK(motor_output(11.0f) == 700);
  CHECK(motor_output(700.0f) == 700);
  CHECK(motor_output(701.0f) == 701);
  CHECK(motor_output(4095.0f) == 4095);
  CHECK(motor_output(5000.0f) == 4095);
  CHECK(motor_output(-5000.0f) == -4095);
  CHECK(motor_output(NAN) == 0);
}

void test_minimum_jerk() {
  MinimumJerk jerk;
  jerk.aim(0.0f);
  CHECK(jerk.step(0.1f) == 0.0f);  // T = 0
  jerk.aim(100.0f);
  for (int i = 0; i < 9; ++i) jerk.step(0.1f);
  CHECK(is_near(static_cast<double>(jerk.value()), 50.0, 0.01));
  for (int i = 0; i < 10; ++i) jerk.step(0.1f);
  CHECK(jerk.value() == 100.0f);
}

void test_targets_that_tremble() {
  MinimumJerk jerk;
  float fastest = 0.0f;
  for (int i = 0; i < 90; ++i) {
    const float before = jerk.value();
    if (i % 3 == 0) jerk.aim(i % 2 == 0 ? 100.0f : 101.0f);
    const float change = jerk.step(1.0f / 30.0f) - before;
    fastest = change > fastest ? change : fastest;
  }
  CHECK(jerk.value() >= 100.0f && jerk.value() <= 101.0f);
  CHECK(fastest * 30.0f <= 1.875f / kSecondsPerTick + 0.1f);
  jerk.stop_at_once();
  CHECK(jerk.value() == 0.0f && jerk.step(0.1f) == 0.0f);
}

void test_filter() {
  Wheel wheel(left_gains());
  wheel.step(20, 0.1f);
  CHECK(is_near(static_cast<double>(wheel.speed_ticks_s()), 10.0, 1e-3));
  wheel.step(20, 0.1f);
  CHECK(is_near(static_cast<double>(wheel.speed_ticks_s()), 19.0, 1e-3));
}

void test_kinematics() {
  Drive drive;
  float left = 0.0f;
  float right = 0.0f;
  drive.wheel_speeds(0.2f, 0.0f, left, right);
  CHECK(is_near(static_cast<double>(left), 0.2 / 0.0012271846, 0.1));
  drive.wheel_speeds(-2.0f, 1.0f, left, right);
  CHECK(left >= -280.01f && right >= -280.01f);
  Pose pose = {0.0, 0.0, 0.0};
  for (int i = 0; i < 400; ++i) pose = drive.integrate(pose, 1.0f, 3.0f);
  CHECK(pose.theta_rad > -3.1416 && pose.theta_rad <= 3.1416);
}

void test_float64() {
  uint8_t bytes[8];
  write_float64(bytes, -0.3436f);
  CHECK(read_float64(bytes) == -0.3436f);
  const uint8_t huge[8] = {0, 0, 0, 0, 0, 0, 0xF0, 0x7F};
  CHECK(read_float64(huge) > 1e30f);
}

struct BenchHal : public Hal {
  uint64_t now_us = 0xFFF00000u;  // micros() wraps within a second
  UartRing ring{0};
  World world;
  uint32_t sent = 0;
  uint32_t milliseconds() override { return static_cast<uint32_t>(now_us / 1000); }
  uint32_t micros() override { return static_cast<uint32_t>(now_us); }
  int read() override { return ring.read(); }
  size_t write(const uint8_t*, size_t size) override {
    sent += static_cast<uint32_t>(size);
    return size;
  }
  void drive(int16_t left, int16_t right) override { world.drive(left, right); }
  void edges(uint32_t& left, uint32_t& right) override {
    left = world.left().edges();
    right = world.right().edges();
  }
};

BenchHal hal;
Robot robot(hal);

void put(const uint8_t* bytes, size_t size) {
  for (size_t i = 0; i < size; ++i) hal.ring.put_on_line(bytes[i], hal.micros());
}

void put_frame(uint16_t id, const uint8_t* payload, uint8_t size) {
  uint8_t frame[80] = {0xFF, 0xFE, size, 0, static_cast<uint8_t>(~size), static_cast<uint8_t>(id), 0};
  uint8_t sum = static_cast<uint8_t>(id);
  for (uint8_t i = 0; i < size; ++i) {
    frame[7 + i] = payload[i];
    sum = static_cast<uint8_t>(sum + payload[i]);
  }
  frame[7 + size] = static_cast<uint8_t>(~sum);
  put(frame, static_cast<size_t>(8 + size));
}

void run_ms(int ms, bool commands) {
  uint8_t twist[kTwistBytes] = {};
  write_float64(twist, 0.2f);
  for (int i = 0; i < ms; ++i) {
    if (commands && i % 100 == 0) put_frame(100, twist, sizeof twist);
    hal.now_us += 1000;
    hal.world.run_until(hal.micros());
    robot.loop();
  }
}

void test_robot() {
  robot.setup();
  put_frame(0, nullptr, 0);
  run_ms(100, false);
  CHECK(robot.node().is_configured());
  CHECK(hal.sent > 600);  // six TopicInfos
  run_ms(5000, true);
  CHECK(hal.world.left().speed_ticks_s() > 100.0);
  CHECK(robot.pose().x_m > 0.3);
  run_ms(600, false);
  CHECK(hal.world.left().speed_ticks_s() < 100.0);
  run_ms(500, false);
  CHECK(hal.world.left().speed_ticks_s() < 2.0);
}

void test_ring() {
  UartRing ring(38400);
  for (int i = 0; i < 400; ++i) ring.put_on_line(0, 0);
  ring.run_until(33000);
  CHECK(ring.lost() == 0);
  ring.run_until(40000);
  CHECK(ring.lost() >= 25 && ring.lost() <= 28);
}

void test_out() {
  const uint8_t bytes[200] = {};
  UartOut out(38400);
  CHECK(out.put(bytes, sizeof bytes, 1000) == 128);
  CHECK(out.ready(1000) == 0);
  CHECK(out.ready(1000 + 2600) == 10);
  out.drop(10);
  CHECK(out.put(bytes, 50, 1000 + 2600) == 10);
  CHECK(out.ready(1000 + 200 * 260) == 118);  // in one piece: up to the ring's end
  out.drop(118);
  CHECK(out.ready(1000 + 200 * 260) == 10);
  out.drop(10);
  CHECK(out.put(bytes, 1, 1000000) == 1);  // an idle line: the byte begins now
  CHECK(out.ready(1000000 + 250) == 0);
  CHECK(out.ready(1000000 + 270) == 1);
}

void test_motor_levels() {
  CHECK(motor_levels(700, false).direction && !motor_levels(700, true).direction);
  CHECK(!motor_levels(-700, false).direction && motor_levels(-700, true).direction);
  CHECK(motor_levels(-700, true).duty == 700 && !motor_levels(-700, true).brake);
  CHECK(motor_levels(0, false).brake && motor_levels(0, false).duty == kPwmMax);
}

// On the shield's L298 the PWM is the enable: without it BRAKE does nothing.
void test_brake() {
  double rolled_m[2] = {0.0, 0.0};
  for (int is_enabled = 0; is_enabled < 2; ++is_enabled) {
    World world;
    const MotorLevels braked = {true, true, static_cast<int16_t>(is_enabled * kPwmMax)};
    world.drive(kPwmMax, kPwmMax);
    for (int ms = 0; ms < 1000; ++ms) world.step(0.001);
    const double before_m = world.rolled_m();
    world.set(braked, braked);
    for (int ms = 0; ms < 1000; ++ms) world.step(0.001);
    CHECK(world.left().speed_rad_s() == 0.0);
    rolled_m[is_enabled] = world.rolled_m() - before_m;
  }
  CHECK(rolled_m[0] > 5.0 * rolled_m[1]);
}

void test_world_parameters() {
  WorldParameters world;
  CHECK(read_world("# a comment\n\ntrack_m=0.2125\nleft.radius_m=4.52e-2\r\nright.slip_noise_m=.003\n", world) == 0);
  CHECK(is_near(world.track_m, 0.2125, 1e-15) && is_near(world.left.radius_m, 0.0452, 1e-15));
  CHECK(is_near(world.right.slip_noise_m, 0.003, 1e-15) && is_near(world.right.radius_m, 0.045, 0.0));
  CHECK(read_world("track_m=0.2\nradius_m=0.045\n", world) == 2);
  CHECK(read_world("track_m=0.2 m", world) == 1);
  CHECK(read_world("track_m=", world) == 1);
  CHECK(read_world("left.radius_m=-1e", world) == 1);
}

}  // namespace

int main() {
  RUN(test_motor_output);
  RUN(test_minimum_jerk);
  RUN(test_targets_that_tremble);
  RUN(test_filter);
  RUN(test_kinematics);
  RUN(test_float64);
  RUN(test_ring);
  RUN(test_out);
  RUN(test_motor_levels);
  RUN(test_brake);
  RUN(test_world_parameters);
  RUN(test_robot);
  return test::report();
}
