// The firmware on an emulated Cortex-M3 in virtual time: runs a script (host/world_script.h) that QEMU has loaded into
// the memory at kScriptAt, writes its rows to the file rows.bin in QEMU's folder, and ends the emulation: 0, or 1 after
// a wrong line. Semihosting: Arm's "Semihosting for AArch32", 3.0.
#include <stdint.h>

#include "../host/world_script.h"
#include "mps2.h"

extern "C" void leave(int status);
extern "C" void uart_interrupt() {}

namespace {

const uint32_t kOpen = 0x01;
const uint32_t kClose = 0x02;
const uint32_t kWrite = 0x05;
const uint32_t kWriteBinary = 5;  // the mode "wb"

hostlink::RobotInWorld robot(hostlink::WorldParameters(), 0, "/robot_0/", ros::Retry::kKeepState);

uint32_t call(uint32_t number, uint32_t first, uint32_t second, uint32_t third) {
  uint32_t block[3] = {first, second, third};
  register uint32_t operation __asm__("r0") = number;
  register uint32_t* argument __asm__("r1") = block;
  __asm__ volatile("bkpt 0xAB" : "+r"(operation) : "r"(argument) : "memory");
  return operation;
}

uint32_t address(const void* memory) { return reinterpret_cast<uint32_t>(memory); }

void write_row(void* file, const double* row) {
  call(kWrite, *static_cast<uint32_t*>(file), address(row), hostlink::RobotInWorld::kColumns * sizeof(double));
}

}  // namespace

extern "C" int main() {
  const char name[] = "rows.bin";
  uint32_t file = call(kOpen, address(name), kWriteBinary, sizeof name - 1);
  const uint32_t wrong = hostlink::run_script(robot, mps2::loaded_text(), write_row, &file);
  call(kClose, file, 0, 0);
  return wrong == 0 ? 0 : 1;
}
