// An emulated Uno (simavr) whose UART is a connection to the host: runs the image of a sketch with Arduino's core, as
// it is flashed.
//
//   uno IMAGE HOST PORT    runs as fast as a real Uno, or slower
//   uno IMAGE              runs in steps: for each line "MILLISECONDS HEX" of its input it receives these bytes, runs
//   for
//                          this time, and writes "sent HEX"
//
// The program writes a line for each change of the LED: "digital 13 LEVEL".
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#include <iostream>
#include <string>

#include "../any_board/tcp_socket.h"

extern "C" {
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
}

namespace {

const uint64_t kHertz = 16000000;
const uint64_t kCyclesPerTurn = kHertz / 1000;
const uint64_t kCyclesPerByte = kHertz * 10 / 57600;
const int kLedBit = 5;  // of port B

struct Line {
  TcpSocket socket;
  bool is_in_steps = false;
  std::string from_host;  // in steps
  size_t from_host_at = 0;
  bool can_receive = true;
  uint64_t next_at = 0;
};

Line line;

uint64_t now_us() {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<uint64_t>(now.tv_sec) * 1000000u + static_cast<uint64_t>(now.tv_nsec) / 1000u;
}

void send(avr_irq_t*, uint32_t value, void*) {
  const uint8_t byte = static_cast<uint8_t>(value);
  if (line.is_in_steps) {
    printf("%02x", byte);
  } else {
    line.socket.write(&byte, 1);
  }
}

void begin_receiving(avr_irq_t*, uint32_t, void*) { line.can_receive = true; }
void end_receiving(avr_irq_t*, uint32_t, void*) { line.can_receive = false; }

void report_led(avr_irq_t*, uint32_t value, void*) {
  if (line.is_in_steps) return;
  printf("digital 13 %u\n", value & 1u);
  fflush(stdout);
}

avr_t* make_board(const char* image) {
  elf_firmware_t firmware = {};
  avr_t* avr = avr_make_mcu_by_name("atmega328p");
  if (avr == nullptr || elf_read_firmware(image, &firmware) != 0) return nullptr;
  avr_init(avr);
  avr->log = LOG_NONE;
  firmware.frequency = kHertz;
  avr_load_firmware(avr, &firmware);
  return avr;
}

avr_irq_t* wire_up(avr_t* avr) {
  uint32_t flags = 0;
  avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
  flags &= ~static_cast<uint32_t>(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POOL_SLEEP);
  avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  const uint32_t uart = AVR_IOCTL_UART_GETIRQ('0');
  avr_irq_register_notify(avr_io_getirq(avr, uart, UART_IRQ_OUTPUT), &send, nullptr);
  avr_irq_register_notify(avr_io_getirq(avr, uart, UART_IRQ_OUT_XON), &begin_receiving, nullptr);
  avr_irq_register_notify(avr_io_getirq(avr, uart, UART_IRQ_OUT_XOFF), &end_receiving, nullptr);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), kLedBit), &report_led, nullptr);
  return avr_io_getirq(avr, uart, UART_IRQ_INPUT);
}

bool has_byte() { return line.is_in_steps ? line.from_host_at < line.from_host.size() : line.socket.available() > 0; }

uint8_t next_byte() {
  return line.is_in_steps ? static_cast<uint8_t>(line.from_host[line.from_host_at++])
                          : static_cast<uint8_t>(line.socket.read());
}

void receive(avr_t* avr, avr_irq_t* input) {
  if (!line.can_receive || avr->cycle < line.next_at || !has_byte()) return;
  line.next_at = avr->cycle + kCyclesPerByte;
  avr_raise_irq(input, next_byte());
}

// False: the program of the board has ended.
bool run_until(avr_t* avr, avr_irq_t* input, uint64_t turn) {
  while (avr->cycle < turn * kCyclesPerTurn) {
    const int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) return false;
    if (avr->cycle >= line.next_at) receive(avr, input);
  }
  return true;
}

int run_in_steps(avr_t* avr, avr_irq_t* input) {
  uint64_t turn = 0;
  std::string step;
  while (std::getline(std::cin, step)) {
    const size_t space = step.find(' ');
    turn += static_cast<uint64_t>(atoi(step.c_str()));
    for (size_t at = space + 1; space != std::string::npos && at + 2 <= step.size(); at += 2) {
      line.from_host += static_cast<char>(strtol(step.substr(at, 2).c_str(), nullptr, 16));
    }
    printf("sent ");
    if (!run_until(avr, input, turn)) return 1;
    printf("\n");
    fflush(stdout);
  }
  return 0;
}

}  // namespace

int main(int count, char** words) {
  avr_t* avr = count == 2 || count == 4 ? make_board(words[1]) : nullptr;
  line.is_in_steps = count == 2;
  if (avr == nullptr || (!line.is_in_steps && !line.socket.connect(words[2], static_cast<uint16_t>(atoi(words[3]))))) {
    fprintf(stderr, "usage: %s IMAGE [HOST PORT]\n", words[0]);
    return 2;
  }
  avr_irq_t* input = wire_up(avr);
  if (line.is_in_steps) return run_in_steps(avr, input);
  const uint64_t began_us = now_us();
  for (uint64_t turn = 1;; ++turn) {
    if (!run_until(avr, input, turn)) return 1;
    const uint64_t passed_us = now_us() - began_us;
    if (turn * 1000 > passed_us) usleep(static_cast<useconds_t>(turn * 1000 - passed_us));
  }
}
