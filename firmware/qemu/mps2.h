// The registers of QEMU's mps2-an385 that are used here: CMSDK UARTs and timers (Arm DAI 0385, DDI 0479).
#pragma once

#include <stdint.h>

namespace mps2 {

struct Uart {
  volatile uint32_t data;
  volatile uint32_t state;  // 1: transmit full, 2: receive full
  volatile uint32_t control;
  volatile uint32_t interrupt;  // 1: transmit, 2: receive; write to clear
  volatile uint32_t divider;
};

struct Timer {
  volatile uint32_t control;
  volatile uint32_t value;
  volatile uint32_t reload;
  volatile uint32_t interrupt;
};

inline Uart& uart0() { return *reinterpret_cast<Uart*>(0x40004000); }
inline Uart& uart1() { return *reinterpret_cast<Uart*>(0x40005000); }
inline Timer& timer0() { return *reinterpret_cast<Timer*>(0x40000000); }
inline volatile uint32_t& interrupt_enable() { return *reinterpret_cast<volatile uint32_t*>(0xE000E100); }

// Text that QEMU loads there before the start, ended by a zero (`-device
// loader,force-raw=on,addr=0x21000000,file=...`): the board's external RAM, which the Due does not have and the
// firmware does not use. Without it the text is empty.
inline const char* loaded_text() { return reinterpret_cast<const char*>(0x21000000); }

const uint32_t kClockHz = 25000000;
const uint32_t kTransmitFull = 1;
const uint32_t kReceiveFull = 2;

struct SysTick {
  volatile uint32_t control;
  volatile uint32_t reload;
  volatile uint32_t value;
};

inline SysTick& sys_tick() { return *reinterpret_cast<SysTick*>(0xE000E010); }

}  // namespace mps2
