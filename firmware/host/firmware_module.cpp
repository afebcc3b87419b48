// The firmware in its world as one WebAssembly module (tools/build_world.py): hostlink/workbench/sim/firmware_module.py and
// docs/try.html run it. One instance of the module is one robot. It has no heap and no imports: its input and output
// are in static memory, whose addresses the first functions return.
#include <string.h>

#include "robot_in_world.h"
#include "world_script.h"

using hostlink::ControlProfile;
using hostlink::DriveTrain;
using hostlink::RobotInWorld;
using hostlink::World;
using hostlink::WorldParameters;

#define EXPORT extern "C" __attribute__((visibility("default")))

extern "C" void __cxa_pure_virtual() { __builtin_trap(); }  // without the C++ library

namespace {

const size_t kTextBytes = 1 << 16;
const size_t kLineBytes = 1 << 16;
const size_t kMostRows = 1 << 13;
const size_t kMostParameters = 64;

// Arguments and results of run() and turn_motors(). A call without arguments costs Python a fifth of a call with
// arguments.
struct Control {
  double step_s;            // in: of turn_motors()
  int32_t left_pwm;         // in: of turn_motors(), as right_pwm and steps
  int32_t right_pwm;        //
  uint32_t steps;           //
  uint32_t ms;              // in: how many milliseconds to let pass
  uint32_t every_ms;        // in: a row at each multiple of it; 0: none
  uint32_t from_host_size;  // in: number of bytes in from_host; out: how many of them did not fit on the line yet
  uint32_t to_host_size;    // out: bytes in to_host
  uint32_t rows;            // out
  uint32_t is_configured;   // out: whether the firmware has a host
  uint32_t lost_bytes;      // out: bytes for which its UART had no room
  uint32_t quiet_ms;        // out: time for which the robot sends nothing, unless the host sends something
};

Control control_block;
char text_buffer[kTextBytes];
char robot_name[256];
double parameter_values[kMostParameters];
uint8_t from_host_bytes[kLineBytes];
uint8_t to_host_bytes[kLineBytes];
double now_row[RobotInWorld::kColumns];
double row_buffer[kMostRows * RobotInWorld::kColumns];
double control_values[8];

struct Placed : RobotInWorld {
  using RobotInWorld::RobotInWorld;
  static void* operator new(size_t, void* at) { return at; }
};

alignas(Placed) uint8_t robot_place[sizeof(Placed)];
Placed* robot = nullptr;

WorldParameters parameters() {
  WorldParameters made;
  for (size_t i = 0; i < hostlink::world_parameter_count(); ++i) {
    hostlink::world_parameter(made, i) = parameter_values[i];
  }
  return made;
}

// At a new speed within 0.3 s, like small robots of today.
ControlProfile nimble_profile() {
  const hostlink::Gains gains = hostlink::make_gains(12.0f, 120.0f, 0.0f, hostlink::kFeedback);
  ControlProfile profile = {gains, gains, 0.002f, 0.0001f, 0.6f};
  return profile;
}

DriveTrain& wheel(uint32_t side) { return side == 0 ? robot->world().left() : robot->world().right(); }

void report() {
  robot->report(now_row);
  control_block.is_configured = robot->robot().node().is_configured();
  control_block.lost_bytes = robot->board().from_host().lost();
  control_block.quiet_ms = control_block.from_host_size > 0 ? 0 : robot->quiet_ms();
  double* next = control_values;
  const hostlink::Wheel* const wheels[] = {&robot->robot().left(), &robot->robot().right()};
  for (const hostlink::Wheel* wheel : wheels) {
    const hostlink::Gains& gains = wheel->pid().gains();
    *next++ = static_cast<double>(gains.kp);
    *next++ = static_cast<double>(gains.ki);
    *next++ = static_cast<double>(gains.kd);
    *next++ = static_cast<double>(wheel->target_ticks_s());
  }
}

void add_row(void*, const double* row) {
  if (control_block.rows < kMostRows) {
    memcpy(row_buffer + RobotInWorld::kColumns * control_block.rows, row, RobotInWorld::kColumns * sizeof(double));
  }
  ++control_block.rows;
}

// Put as many bytes of the host on the line as fit; returns how many it has accepted so far.
uint32_t feed_line(uint32_t at) {
  hostlink::UartRing& line = robot->board().from_host();
  while (at < control_block.from_host_size && line.line_room() > 0) {
    line.put_on_line(from_host_bytes[at++], robot->board().line_us());
  }
  return at;
}

// A UART whose reader has no room waits.
void drain_line() {
  hostlink::UartOut& out = robot->board().to_host();
  for (size_t size = 0; (size = out.ready(robot->board().line_us())) > 0;) {
    if (control_block.to_host_size + size > kLineBytes) return;
    memcpy(to_host_bytes + control_block.to_host_size, out.data(), size);
    control_block.to_host_size += static_cast<uint32_t>(size);
    out.drop(size);
  }
}

}  // namespace

// -- addresses of input and output ------------------------------------------------------------------------------------

EXPORT Control* control() { return &control_block; }
EXPORT char* text() { return text_buffer; }                      // of kTextBytes, with a terminating zero
EXPORT double* parameter_numbers() { return parameter_values; }  // of a world, in the order of WorldParameters
EXPORT uint8_t* from_host() { return from_host_bytes; }
EXPORT uint8_t* to_host() { return to_host_bytes; }
EXPORT double* row() { return now_row; }  // the present state, one number for each column
EXPORT double* rows() { return row_buffer; }
// Of the left wheel's control, then of the right one's: Kp, Ki, Kd, and the last commanded speed in ticks/s.
EXPORT double* wheel_controls() { return control_values; }

// -- the names and the ranges of its numbers --------------------------------------------------------------------------

EXPORT uint32_t column_count() { return RobotInWorld::kColumns; }
EXPORT const char* column(uint32_t index) { return RobotInWorld::column(index); }
EXPORT uint32_t parameter_count() { return static_cast<uint32_t>(hostlink::world_parameter_count()); }
EXPORT const char* parameter_name(uint32_t index) { return hostlink::world_parameter_name(index); }
EXPORT double parameter_least(uint32_t index) { return hostlink::world_parameter_least(index); }
EXPORT double parameter_most(uint32_t index) { return hostlink::world_parameter_most(index); }

// Read lines name=value from text() into parameter_numbers(); parameters without a line keep their default. Returns 0,
// or the number of the first wrong line.
EXPORT uint32_t read_parameters() {
  WorldParameters made;
  const uint32_t wrong = hostlink::read_world(text_buffer, made);
  for (size_t i = 0; i < hostlink::world_parameter_count(); ++i) {
    parameter_values[i] = hostlink::world_parameter(made, i);
  }
  return wrong;
}

// -- the robot --------------------------------------------------------------------------------------------------------

// A new robot in a new world of parameter_numbers(); text() is its name. `baud` 0: bytes are through at once; `retry`:
// a policy of ros/node.h; `feedback`: one of constants.h; `is_nimble`: with the gains of today's small robots.
EXPORT void power_on(uint32_t baud, uint32_t retry, uint32_t feedback, uint32_t is_nimble) {
  strncpy(robot_name, text_buffer, sizeof robot_name - 1);
  robot = new (robot_place)
      Placed(parameters(), baud, robot_name, static_cast<ros::Retry>(retry), static_cast<hostlink::Feedback>(feedback),
             is_nimble != 0 ? nimble_profile() : hostlink::paper_profile());
  report();
}

// Lets time pass, by control().
EXPORT void run() {
  control_block.to_host_size = control_block.rows = 0;
  uint32_t fed = 0;
  for (uint32_t i = 0; i < control_block.ms; ++i) {
    fed = feed_line(fed);
    robot->pass();
    drain_line();
    if (control_block.every_ms == 0 || robot->board().now_us() / 1000 % control_block.every_ms != 0) continue;
    double made[RobotInWorld::kColumns];
    robot->report(made);
    add_row(nullptr, made);
  }
  control_block.from_host_size -= fed;
  memmove(from_host_bytes, from_host_bytes + fed, control_block.from_host_size);
  report();
}

// Power off and on: the firmware starts again in the same world.
EXPORT void reboot() {
  control_block.from_host_size = 0;
  robot->reboot();
  report();
}

// The line is cut: bytes on it are lost.
EXPORT void cut() {
  control_block.from_host_size = 0;
  robot->board().cut();
}

EXPORT void set_clock(uint32_t per_mille) { robot->board().set_clock(per_mille); }

// Run the script in text() (world_script.h) with the robot, which must be new. Returns 0, or the number of the first
// wrong line. The rows are in rows(), as far as they fit.
EXPORT uint32_t run_script() {
  control_block.rows = 0;
  const uint32_t wrong = hostlink::run_script(*robot, text_buffer, add_row, nullptr);
  report();
  return wrong;
}

// -- its world --------------------------------------------------------------------------------------------------------
// A side is 0 (left) or 1 (right).

EXPORT void change_world() {  // to parameter_numbers(); pose and edges stay
  robot->world().be(parameters());
  report();
}

// Drives the motors without the firmware, by control().
EXPORT void turn_motors() {
  const Control& told = control_block;
  robot->world().drive(static_cast<int16_t>(told.left_pwm), static_cast<int16_t>(told.right_pwm));
  for (uint32_t i = 0; i < told.steps; ++i) robot->world().step(told.step_s);
  report();
}

EXPORT void shove(double forward_m, double sideways_m, double turned_rad) {
  robot->world().shove(forward_m, sideways_m, turned_rad);
  report();
}

EXPORT void grip(uint32_t side, double ticks_s) {
  wheel(side).grip(ticks_s);
  report();
}

EXPORT void release(uint32_t side) { wheel(side).release(); }
EXPORT void deafen(uint32_t side, uint32_t is_so) { wheel(side).deafen(is_so != 0); }
EXPORT void break_driver(uint32_t side) { wheel(side).break_driver(); }
