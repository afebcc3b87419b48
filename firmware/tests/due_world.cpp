// The Due's whole program, with its board, in a world that a test draws: the pins go to a shield and two motors, and
// the encoders return as interrupts. For Python's ctypes.
//
// The board's pins exist once: run one instance at a time. The firmware without its board: ../host/firmware_module.cpp.
#include <Arduino.h>
#include <stdint.h>
#include <string.h>

#include "../due/src/board/due_board.h"
#include "../due/src/robot.h"
#include "../host/due_arduino/pins.h"
#include "../host/world.h"

using namespace hostlink;

namespace {

const uint32_t kDirectionPin[2] = {2, 5};  // left, right: docs/build-robot.md
const uint32_t kBrakePin[2] = {9, 8};
const uint32_t kPwmPin[2] = {3, 6};
const uint32_t kEncoderPin[2] = {22, 23};
const uint32_t kPassUs = 1000;
const int kColumns = 15;

struct BoardInWorld {
  DueBoard board;
  Robot robot;
  World world;
  uint32_t edges[2] = {0, 0};
  bool is_deaf[2] = {false, false};   // dead encoder
  bool is_stuck[2] = {false, false};  // broken driver: the motor runs at full speed, whatever the pins command
  BoardInWorld() : robot(board) {}

  DriveTrain& wheel(int side) { return side == 0 ? world.left() : world.right(); }

  MotorLevels levels(int side) const {
    const due_pins::Pins& pins = due_pins::pins();
    if (is_stuck[side]) return motor_levels(kPwmMax, side == 1);
    MotorLevels found = {pins.value[kDirectionPin[side]] != 0, pins.value[kBrakePin[side]] != 0,
                         static_cast<int16_t>(pins.value[kPwmPin[side]])};
    return found;
  }

  // One millisecond: work of the hardware, then a pass of the loop.
  void pass() {
    due_pins::pins().now_us += kPassUs;
    world.set(levels(0), levels(1));
    world.run_until(static_cast<uint32_t>(due_pins::pins().now_us));
    for (int side = 0; side < 2; ++side) {
      while (edges[side] != wheel(side).edges()) {
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

  // Drive of the motor, forwards positive; 0 while it brakes or runs free.
  double drive(int side) const {
    const MotorLevels now = levels(side);
    if (now.brake) return 0.0;
    return now.direction == (side == 0) ? now.duty : -now.duty;
  }

  void report(double* row) const {
    row[0] = static_cast<double>(due_pins::pins().now_us) * 1e-6;
    row[1] = world.left().speed_ticks_s();
    row[2] = world.right().speed_ticks_s();
    row[3] = static_cast<double>(robot.left().set_point_ticks_s());
    row[4] = static_cast<double>(robot.right().set_point_ticks_s());
    row[5] = world.pose().x_m;
    row[6] = world.pose().y_m;
    row[7] = world.pose().theta_rad;
    row[8] = robot.pose().x_m;
    row[9] = robot.pose().y_m;
    row[10] = robot.pose().theta_rad;
    row[11] = drive(0);
    row[12] = drive(1);
    row[13] = world.left().rolled_ticks();
    row[14] = world.right().rolled_ticks();
  }
};

}  // namespace

void watchdogSetup();  // of the sketch; the Due's core calls it before setup(), and without it turns the watchdog off

extern "C" {

void world_hang(BoardInWorld*, uint32_t ms);

BoardInWorld* world_new(const double* parameters, uint32_t setup_ms, uint32_t reset_type) {
  due_pins::power_up();
  RSTC->RSTC_SR = reset_type << RSTC_SR_RSTTYP_Pos;
  watchdogSetup();
  BoardInWorld* made = new BoardInWorld();
  WorldParameters drawn;
  for (size_t i = 0; i < world_parameter_count(); ++i) world_parameter(drawn, i) = parameters[i];
  made->world.be(drawn);
  made->board.begin();
  made->robot.setup();
  world_hang(made, setup_ms);  // other work of a user in setup()
  return made;
}
// The program blocks for this time, for example by a delay() in its loop.
void world_hang(BoardInWorld*, uint32_t ms) { due_pins::pins().now_us += ms * uint64_t{1000}; }
uint32_t world_restarts(BoardInWorld*) { return due_pins::pins().restarts; }
void world_delete(BoardInWorld* world) { delete world; }
void world_grip(BoardInWorld* world, int side, double ticks_s) { world->wheel(side).grip(ticks_s); }
void world_release(BoardInWorld* world, int side) { world->wheel(side).release(); }
void world_deafen(BoardInWorld* world, int side, int on) { world->is_deaf[side] = on != 0; }
void world_stick(BoardInWorld* world, int side, int on) { world->is_stuck[side] = on != 0; }
void world_feed(BoardInWorld*, const uint8_t* bytes, size_t size) {
  due_pins::pins().from_host.insert(due_pins::pins().from_host.end(), bytes, bytes + size);
}
// Let this many milliseconds pass; one row every ten.
size_t world_run(BoardInWorld* world, uint32_t ms, double* rows, size_t capacity) {
  size_t count = 0;
  for (uint32_t i = 1; i <= ms; ++i) {
    world->pass();
    if (i % 10 == 0 && count < capacity) world->report(rows + kColumns * count++);
  }
  return count;
}
size_t world_sent(BoardInWorld*, uint8_t* out, size_t capacity) {
  std::string& sent = due_pins::pins().to_host;
  const size_t size = sent.size() < capacity ? sent.size() : capacity;
  memcpy(out, sent.data(), size);
  sent.erase(0, size);
  return size;
}
// The writes to pins since the last call, each a pin and a value.
size_t world_writes(BoardInWorld*, uint16_t* out, size_t capacity) {
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
int world_pin(BoardInWorld*, uint32_t pin) { return due_pins::pins().value[pin]; }
int world_resolution_bits(BoardInWorld*) { return due_pins::pins().resolution_bits; }
}
