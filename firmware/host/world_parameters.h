// WorldParameters: every number of a world, with its unit, default and source.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace hostlink {

const double kTurnRad = 6.283185307179586;
const double kFullPwm = 4095.0;

// Parameters of one wheel; the defaults are the paper's robot without a flaw.
struct WheelParameters {
  double full_speed_rad_s = 280.0 * kTurnRad / 230.4;  // with full PWM, rated voltage; docs/paper-robot.md#numbers
  double dead_zone_pwm = 350.0;                        // the wheel stops below it; half of the paper's dead band of 700
  double has_jump = 1.0;                               // 1: above the dead zone as if there were none; 0: from nothing
  double rise_constant_s = 0.1;                        // while its PWM pushes it; geared 12 V motors have 0.03..0.2
  double coast_constant_s = 0.3;                       // while it runs free; estimated
  double brake_constant_s = 0.04;                      // while it is shorted, behind its 75:1 gear; estimated
  double friction_rad_s = 24.0 * kTurnRad / 230.4;     // speed lost to friction in one time constant: ends coasting

  double radius_m = 0.045;        // at its contact with the floor; docs/paper-robot.md#numbers
  double ticks_per_turn = 230.4;  // periods of its encoder, two edges each; docs/paper-robot.md#numbers
  double slip_noise_m = 0.0;      // standard deviation after 1 m, grows with the root; 0.001..0.005 on hard floors
  double slip_accelerating_s2_m = 0.0;  // share of the way lost for each m/s2 of acceleration; 0..0.02
  double slip_braking_s2_m = 0.0;       // share of the way slid on for each m/s2 of deceleration; 0..0.02
};

// All are doubles, so that they pass through the module's interface as one array, in this order.
struct WorldParameters {
  double seed = 1.0;      // of the random numbers, a whole number of 0..2^32-1; equal seeds repeat
  double track_m = 0.21;  // wheel to wheel where they touch the floor; docs/paper-robot.md#numbers

  double caster_arm_m = 0.15;     // from the axle back to the caster's pivot; estimated from the paper's figure 2
  double caster_trail_m = 0.02;   // from the pivot to where the wheel touches; "almost as large as the wheel's radius"
  double caster_pwm = 0.0;        // counts of PWM that a caster costs when it points the wrong way; estimated 0..300
  double caster_twist_rad = 0.0;  // twist of the robot by a caster at a right angle; 0.055 fits the paper's tables
  double caster_random = 0.0;     // standard deviation of that angle, as a share; 0.4 fits them

  double floor_pwm = 0.0;      // counts of PWM that the floor costs a rolling wheel: 0 hard, 100..300 carpet; estimated
  double pwm_bits = 8.0;       // that analogWrite puts on the pin, of 12: steps of 16; the Due core's variant.h
  double battery_v = 12.0;     // without load; the paper's supply
  double rated_v = 12.0;       // at which the motors' speeds were measured; RHE158 12 V
  double battery_sag_v = 0.0;  // lost while both motors are driven with full PWM; 0.5..1.5 for ten alkaline cells

  WheelParameters left;
  WheelParameters right;
};

// The numbers by name ("track_m", "left.radius_m"), in the order of the struct.
size_t world_parameter_count();
const char* world_parameter_name(size_t index);
double world_parameter_least(size_t index);
double world_parameter_most(size_t index);
double& world_parameter(WorldParameters& parameters, size_t index);

// Reads lines "name=value"; empty lines and those that begin with # are ignored. Returns 0, or the number of the first
// line that names no parameter, or whose value is invalid or out of its range.
uint32_t read_world(const char* text, WorldParameters& parameters);

// Reads a decimal number: digits, a point, an exponent. Returns its end, or nullptr if there is no number.
const char* read_number(const char* at, double& value);

}  // namespace hostlink
