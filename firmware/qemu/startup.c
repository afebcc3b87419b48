// Vectors, memory, constructors. A fault ends the emulation with status 1 instead of hanging it.
#include <stdint.h>

extern uint32_t _stack_top, _data_load, _data_begin, _data_end, _bss_begin, _bss_end;
extern void (*_init_begin[])(void);
extern void (*_init_end[])(void);

int main(void);
void uart_interrupt(void);

void* __dso_handle = 0;
void __cxa_pure_virtual(void) {
  for (;;) {
  }
}

// Semihosting: SYS_EXIT_EXTENDED with ADP_Stopped_ApplicationExit and a status.
void leave(int status) {
  uint32_t block[2] = {0x20026, (uint32_t)status};
  register uint32_t operation __asm__("r0") = 0x20;
  register uint32_t* argument __asm__("r1") = block;
  __asm__ volatile("bkpt 0xAB" : : "r"(operation), "r"(argument) : "memory");
  for (;;) {
  }
}

static void fault(void) { leave(1); }
static void wake(void) {}  // the tick only ends a sleep: a counter keeps the time

void reset(void) {
  uint32_t* from = &_data_load;
  for (uint32_t* to = &_data_begin; to < &_data_end; ++to) *to = *from++;
  for (uint32_t* to = &_bss_begin; to < &_bss_end; ++to) *to = 0;
  for (void (**constructor)(void) = _init_begin; constructor < _init_end; ++constructor) (*constructor)();
  leave(main());
}

// 16 of the core, then 32 of the board: UART0 receives on the first of them.
__attribute__((section(".vectors"), used)) static void (*const vectors[48])(void) = {
    (void (*)(void)) & _stack_top, reset, fault, fault, fault, fault, fault, 0, 0, 0, 0, fault, fault, 0, fault, wake,
    [16] = uart_interrupt,
};
