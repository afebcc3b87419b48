// The C interface of RobotInWorld and World, for a shared library: hostlink/sim/firmware_world.py and native_world.py.
// Parameters are the numbers of WorldParameters in their order; a side is 0 (left) or 1 (right).
#include <string.h>

#include <deque>
#include <string>

#include "robot_in_world.h"
#include "world_script.h"

using hostlink::DriveTrain;
using hostlink::RobotInWorld;
using hostlink::World;
using hostlink::WorldParameters;

namespace {

const uint32_t kVersion = 2;  // of this interface: the binding refuses another

WorldParameters parameters_of(const double* values) {
  WorldParameters parameters;
  for (size_t i = 0; i < hostlink::world_parameter_count(); ++i) hostlink::world_parameter(parameters, i) = values[i];
  return parameters;
}

DriveTrain& wheel(World& world, int side) { return side == 0 ? world.left() : world.right(); }

struct Rows {
  double* next;
  size_t room;
};

void add_row(void* context, const double* row) {
  Rows& rows = *static_cast<Rows*>(context);
  if (rows.room == 0) return;
  memcpy(rows.next, row, RobotInWorld::kColumns * sizeof(double));
  rows.next += RobotInWorld::kColumns;
  --rows.room;
}

}  // namespace

struct FirmwareWorld {
  std::string name;
  RobotInWorld robot;
  std::deque<uint8_t> from_host;  // not on the line yet
  std::string to_host;            // through the line

  FirmwareWorld(const double* values, uint32_t baud, const char* name_text, int retry, int feedback)
      : name(name_text),
        robot(parameters_of(values), baud, name.c_str(), static_cast<ros::Retry>(retry),
              static_cast<hostlink::Feedback>(feedback)) {}

  void pass() {
    hostlink::UartRing& line = robot.board().from_host();
    while (!from_host.empty() && line.line_room() > 0) {
      line.put_on_line(from_host.front(), robot.board().micros());
      from_host.pop_front();
    }
    robot.pass();
    hostlink::UartOut& out = robot.board().to_host();
    for (size_t size = 0; (size = out.ready(robot.board().micros())) > 0;) {
      to_host.append(reinterpret_cast<const char*>(out.data()), size);
      out.drop(size);
    }
  }
};

extern "C" {

uint32_t firmware_world_version() { return kVersion; }
size_t world_parameters_count() { return hostlink::world_parameter_count(); }
const char* world_parameters_name(size_t index) { return hostlink::world_parameter_name(index); }
void world_parameters_defaults(double* values) {
  WorldParameters parameters;
  for (size_t i = 0; i < hostlink::world_parameter_count(); ++i) values[i] = hostlink::world_parameter(parameters, i);
}
// Returns 0, or the number of the line that is wrong.
uint32_t world_parameters_read(const char* text, double* values) {
  WorldParameters parameters;
  const uint32_t wrong = hostlink::read_world(text, parameters);
  for (size_t i = 0; i < hostlink::world_parameter_count(); ++i) values[i] = hostlink::world_parameter(parameters, i);
  return wrong;
}

// -- the firmware in a world
// --------------------------------------------------------------------------------------------

// `baud` 0: bytes are through at once; `retry`: a policy of ros/node.h; `feedback`: one of constants.h.
FirmwareWorld* firmware_world_new(const double* values, uint32_t baud, const char* name, int retry, int feedback) {
  return new FirmwareWorld(values, baud, name, retry, feedback);
}
void firmware_world_delete(FirmwareWorld* self) { delete self; }
World* firmware_world_world(FirmwareWorld* self) { return &self->robot.world(); }
size_t firmware_world_columns() { return RobotInWorld::kColumns; }
const char* firmware_world_column(size_t index) { return RobotInWorld::column(index); }
void firmware_world_send(FirmwareWorld* self, const uint8_t* bytes, size_t size) {
  self->from_host.insert(self->from_host.end(), bytes, bytes + size);
}
// What has passed the line to the host since the last call, at most `capacity`.
size_t firmware_world_receive(FirmwareWorld* self, uint8_t* out, size_t capacity) {
  const size_t size = self->to_host.size() < capacity ? self->to_host.size() : capacity;
  memcpy(out, self->to_host.data(), size);
  self->to_host.erase(0, size);
  return size;
}
void firmware_world_row(FirmwareWorld* self, double* row) { self->robot.report(row); }
// Lets so many milliseconds pass, and writes a row at each multiple of `every_ms` (0: none). Returns the number of
// rows.
size_t firmware_world_run(FirmwareWorld* self, uint32_t ms, uint32_t every_ms, double* rows, size_t capacity) {
  size_t count = 0;
  for (uint32_t i = 1; i <= ms; ++i) {
    self->pass();
    if (every_ms == 0 || self->robot.board().now_us() / 1000 % every_ms != 0 || count == capacity) continue;
    self->robot.report(rows + RobotInWorld::kColumns * count++);
  }
  return count;
}
uint32_t firmware_world_lost_bytes(FirmwareWorld* self) { return self->robot.board().from_host().lost(); }

// Runs a script (world_script.h) in a robot of its own. Returns 0, or the number of the line that is wrong; `capacity`
// is the number of rows, and how many there were.
uint32_t firmware_world_script(const char* text, double* rows, size_t* capacity) {
  RobotInWorld robot(WorldParameters(), 0, "/robot_0/", ros::Retry::kKeepState);
  Rows found = {rows, *capacity};
  const uint32_t wrong = hostlink::run_script(robot, text, add_row, &found);
  *capacity -= found.room;
  return wrong;
}

// -- the world alone
// ----------------------------------------------------------------------------------------------------

World* world_new(const double* values) { return new World(parameters_of(values)); }
void world_delete(World* world) { delete world; }
void world_be(World* world, const double* values) { world->be(parameters_of(values)); }
void world_drive(World* world, int16_t left_pwm, int16_t right_pwm) { world->drive(left_pwm, right_pwm); }
void world_step(World* world, double dt_s) { world->step(dt_s); }
// x, y, theta, rolled, battery, caster; left speed (rad/s) and way (rad), the same right.
void world_state(const World* world, double* out) {
  const double values[] = {world->pose().x_m,           world->pose().y_m,          world->pose().theta_rad,
                           world->rolled_m(),           world->battery_v(),         world->caster_rad(),
                           world->left().speed_rad_s(), world->left().rolled_rad(), world->right().speed_rad_s(),
                           world->right().rolled_rad()};
  memcpy(out, values, sizeof values);
}
uint32_t world_edges(World* world, int side) { return wheel(*world, side).edges(); }
void world_shove(World* world, double forward_m, double sideways_m, double turned_rad) {
  world->shove(forward_m, sideways_m, turned_rad);
}
void world_grip(World* world, int side, double ticks_s) { wheel(*world, side).grip(ticks_s); }
void world_release(World* world, int side) { wheel(*world, side).release(); }
void world_deafen(World* world, int side, int is_so) { wheel(*world, side).deafen(is_so != 0); }
void world_break_driver(World* world, int side) { wheel(*world, side).break_driver(); }
}
