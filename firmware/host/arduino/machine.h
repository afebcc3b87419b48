// The ESP8266 from the view of its sketch: time, a paced UART, a radio, a watchdog. One thread: the hardware catches
// up when the sketch calls into the core, and the sketch sleeps only where the real core lets the SDK run.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "radio.h"
#include "uart_line.h"

namespace standin {

struct Options {
  std::string uart = "listen:0";  // listen:PORT, connect:HOST:PORT or pty
  std::string server = "127.0.0.1";
  uint16_t server_port = 11411;
  std::string key;
  unsigned boot_noise_bytes = 0;  // the ROM's messages at another baud rate
  bool is_uart_paced = true;
  bool is_uart_swapped = false;
  bool waits_for_device = false;  // the power is on when the other end of the UART is connected
  RadioOptions radio;
};

class Machine {
 public:
  void power_up(const Options& options);
  int64_t now_us() const;
  // Work of the core in yield() and delay(): feed the watchdog, let the hardware run, rest until an event.
  void rest(int64_t limit_us);
  void delay(int64_t duration_us);
  void advance();
  std::string stats() const;

  Options options;
  UartLine uart;
  Radio radio;

 private:
  void wait_for_device();
  void take_signals();
  void take_commands();
  void obey(const std::string& command);
  void answer();

  int64_t started_us_ = 0;
  std::string typed_;
  bool has_stdin_ = true;
  int64_t answer_at_us_ = 0;  // 0: no command is pending
};

Machine& machine();

}  // namespace standin
