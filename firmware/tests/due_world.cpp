// The Due's whole program, its board included, in a world that a test draws: the pins go to a shield and two motors,
// the encoders come back as interrupts. For Python's ctypes.
#include <Arduino.h>
#include <stdint.h>
#include <string.h>

#include "../due/src/board/due_board.h"
#include "../due/src/robot.h"
#include "../host/due_arduino/pins.h"
#include "../host/plant.h"

using namespace hostlink;

namespace {

const uint32_t kDirectionPin[2] = {2, 5};  // left, right: ../README.md
const uint32_t kBrakePin[2] = {9, 8};
const uint32_t kPwmPin[2] = {3, 6};
const uint32_t kEncoderPin[2] = {22, 23};
const uint32_t kPassUs = 1000;
const int kColumns = 13;

struct World {
  DueBoard board;
  Robot robot;
  Plant plant;
  uint32_t edges[2] = {0, 0};
  bool is_deaf[2] = {false, false};   // its encoder is dead
  bool is_stuck[2] = {false, false};  // its driver is through: the motor runs at full speed, whatever the pins command
  World() : robot(board) {}

  Motor& motor(int side) { return side == 0 ? plant.left() : plant.right(); }

  MotorLevels levels(int side) const {
    const due_pins::Pins& pins = due_pins::pins();
    if (is_stuck[side]) return motor_levels(kPwmMax, side == 1);
    MotorLevels found = {pins.value[kDirectionPin[side]] != 0, pins.value[kBrakePin[side]] != 0,
                         static_cast<int16_t>(pins.value[kPwmPin[side]])};
    return found;
  }

  // A millisecond: what the hardware does, then a pass of the loop.
  void pass() {
    due_pins::pins().now_us += kPassUs;
    plant.set(levels(0), levels(1));
    plant.run_until(static_cast<uint32_t>(due_pins::pins().now_us));
    for (int side = 0; side < 2; ++side) {
      while (edges[side] != motor(side).edges()) {
        ++edges[side];
        uint16_t& level = due_pins::pins().value[kEncoderPin[side]];
        level = level == 0 ? 1 : 0;
        void (*on_edge)() = due_pins::pins().on_edge[kEncoderPin[side]];
        if (on_edge != nullptr && !is_deaf[side]) on_edge();
      }
    }
    board.run();
    robot.loop();
  }

  // What the motor is driven with, forwards positive; 0 while it brakes or runs free.
  double drive(int side) const {
    const MotorLevels now = levels(side);
    if (now.brake) return 0.0;
    return now.direction == (side == 0) ? now.duty : -now.duty;
  }

  void report(double* row) const {
    row[0] = static_cast<double>(due_pins::pins().now_us) * 1e-6;
    row[1] = static_cast<double>(plant.left().speed_ticks_s());
    row[2] = static_cast<double>(plant.right().speed_ticks_s());
    row[3] = static_cast<double>(robot.left().set_point_ticks_s());
    row[4] = static_cast<double>(robot.right().set_point_ticks_s());
    row[5] = plant.x_m();
    row[6] = plant.y_m();
    row[7] = plant.theta_rad();
    row[8] = robot.pose().x_m;
    row[9] = robot.pose().y_m;
    row[10] = robot.pose().theta_rad;
    row[11] = drive(0);
    row[12] = drive(1);
  }
};

MotorWorld read_motor(const float* values) {
  MotorWorld motor;
  motor.full_speed_ticks_s = values[0];
  motor.time_constant_s = values[1];
  motor.coast_constant_s = values[2];
  motor.brake_constant_s = values[3];
  motor.friction_ticks_s = values[4];
  motor.dead_zone_pwm = values[5];
  motor.has_jump = values[6] != 0.0f;
  motor.caster_pwm = values[7];
  return motor;
}

}  // namespace

void watchdogSetup();  // of the sketch; the Due's core calls it before setup(), and without it turns the watchdog off

extern "C" {

void world_hang(World*, uint32_t ms);

World* world_new(uint32_t setup_ms, uint32_t reset_type) {
  due_pins::power_up();
  RSTC->RSTC_SR = reset_type << RSTC_SR_RSTTYP_Pos;
  watchdogSetup();
  World* made = new World();
  made->board.begin();
  made->robot.setup();
  world_hang(made, setup_ms);  // what else a user does in setup()
  return made;
}
// The program does something else for so long: a delay() in its loop.
void world_hang(World*, uint32_t ms) { due_pins::pins().now_us += ms * uint64_t{1000}; }
uint32_t world_restarts(World*) { return due_pins::pins().restarts; }
void world_delete(World* world) { delete world; }
void world_motor(World* world, int side, const float* values) { world->motor(side).be(read_motor(values)); }
void world_grip(World* world, int side, float ticks_s) { world->motor(side).grip(ticks_s); }
void world_release(World* world, int side) { world->motor(side).release(); }
void world_deafen(World* world, int side, int on) { world->is_deaf[side] = on != 0; }
void world_stick(World* world, int side, int on) { world->is_stuck[side] = on != 0; }
void world_feed(World*, const uint8_t* bytes, size_t size) {
  due_pins::pins().from_host.insert(due_pins::pins().from_host.end(), bytes, bytes + size);
}
// Lets so many milliseconds pass; a row each ten of them.
size_t world_run(World* world, uint32_t ms, double* rows, size_t capacity) {
  size_t count = 0;
  for (uint32_t i = 1; i <= ms; ++i) {
    world->pass();
    if (i % 10 == 0 && count < capacity) world->report(rows + kColumns * count++);
  }
  return count;
}
size_t world_sent(World*, uint8_t* out, size_t capacity) {
  std::string& sent = due_pins::pins().to_host;
  const size_t size = sent.size() < capacity ? sent.size() : capacity;
  memcpy(out, sent.data(), size);
  sent.erase(0, size);
  return size;
}
// The writes to pins since the last call, each a pin and a value.
size_t world_writes(World*, uint16_t* out, size_t capacity) {
  size_t count = 0;
  for (const due_pins::Write& write : due_pins::pins().writes) {
    if (count == capacity) break;
    out[2 * count] = write.pin;
    out[2 * count + 1] = write.value;
    ++count;
  }
  due_pins::pins().writes.clear();
  return count;
}
int world_pin(World*, uint32_t pin) { return due_pins::pins().value[pin]; }
int world_resolution_bits(World*) { return due_pins::pins().resolution_bits; }

Motor* motor_new(const float* values) {
  Motor* made = new Motor(false);
  made->be(read_motor(values));
  return made;
}
void motor_delete(Motor* motor) { delete motor; }
float motor_step(Motor* motor, int direction, int brake, int duty, float dt_s) {
  const MotorLevels levels = {direction != 0, brake != 0, static_cast<int16_t>(duty)};
  return motor->step(levels, dt_s);
}
float motor_speed(Motor* motor) { return motor->speed_ticks_s(); }
uint32_t motor_edges(Motor* motor) { return motor->edges(); }
}
