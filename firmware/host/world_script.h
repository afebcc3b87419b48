// WorldScript: a drive as text, for the native and the emulated firmware alike, in virtual time. Lines:
//
//   name=value                   a number of the world (world_parameters.h); before the first drive
//   drive LINEAR ANGULAR MS      m/s and rad/s, commanded ten times a second for this time
//   wait MS                      the host is silent
//
// After every ten milliseconds the sink gets a row of RobotInWorld.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "robot_in_world.h"

namespace hostlink {

const uint32_t kScriptRowMs = 10;

typedef void (*RowSink)(void* context, const double* row);

// Returns 0, or the number of the first line of another form.
uint32_t run_script(RobotInWorld& robot, const char* text, RowSink sink, void* context);

}  // namespace hostlink
