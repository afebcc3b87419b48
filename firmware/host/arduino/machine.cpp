#include "machine.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <ctime>

namespace standin {

namespace {
constexpr int64_t kTurn_us = 1000;  // the longest rest of an idle loop
constexpr int kWatchdogTicks =
    4;  // of 250 ms of processor time, so that a late scheduler is not counted against the sketch
std::atomic<int> ticks_since_yield{0};
volatile std::sig_atomic_t wifi_signal = 0;
volatile std::sig_atomic_t end_signal = 0;

void on_watchdog_tick(int) {
  if (++ticks_since_yield < kWatchdogTicks) return;
  constexpr char text[] = "soft watchdog: the sketch ran for 1 s without yield() or delay()\n";
  const ssize_t ignored = ::write(STDERR_FILENO, text, sizeof text - 1);
  ::_exit(ignored > 0 ? 70 : 71);
}

void on_wifi_signal(int number) { wifi_signal = number; }
void on_end_signal(int number) { end_signal = number; }

void set_handler(int number, void (*handler)(int)) {
  struct sigaction action {};
  action.sa_handler = handler;
  sigaction(number, &action, nullptr);
}

void start_watchdog() {
  set_handler(SIGPROF, on_watchdog_tick);
  const timeval tick{0, 250000};
  const itimerval timer{tick, tick};
  setitimer(ITIMER_PROF, &timer, nullptr);
}
}  // namespace

Machine& machine() {
  static Machine the_machine;
  return the_machine;
}

int64_t Machine::now_us() const {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1000000LL + now.tv_nsec / 1000 - started_us_;
}

void Machine::power_up(const Options& wanted) {
  options = wanted;
  radio.options = wanted.radio;
  started_us_ = now_us();
  uart.open(options.uart);
  std::fflush(stdout);
  fcntl(STDIN_FILENO, F_SETFL, fcntl(STDIN_FILENO, F_GETFL) | O_NONBLOCK);
  set_handler(SIGUSR1, on_wifi_signal);
  set_handler(SIGUSR2, on_wifi_signal);
  set_handler(SIGTERM, on_end_signal);
  set_handler(SIGINT, on_end_signal);
  if (options.waits_for_device) wait_for_device();
  uart.begin(38400);
  if (!options.is_uart_swapped) uart.add_noise(options.boot_noise_bytes);
  start_watchdog();
}

void Machine::wait_for_device() {
  while (!uart.has_peer()) rest(kTurn_us * 20);
}

void Machine::advance() {
  const int64_t now = now_us();
  uart.advance(now);
  radio.advance(now);
}

void Machine::rest(int64_t limit_us) {
  ticks_since_yield = 0;
  advance();
  take_signals();
  std::vector<pollfd> polled;
  for (const int fd : uart.fds()) polled.push_back({fd, POLLIN, 0});
  for (const int fd : radio.fds(now_us())) polled.push_back({fd, POLLIN, 0});
  if (has_stdin_) polled.push_back({STDIN_FILENO, POLLIN, 0});
  const int64_t now = now_us();
  const int64_t until_us = std::min(uart.next_event_us(now), now + limit_us);
  const int64_t rest_us = std::max<int64_t>(0, until_us - now);
  const timespec limit{rest_us / 1000000, rest_us % 1000000 * 1000};
  ppoll(polled.data(), polled.size(), &limit, nullptr);
  if (has_stdin_ && polled.back().revents != 0) take_commands();
  if (answer_at_us_ != 0 && now_us() >= answer_at_us_) answer();
  advance();
}

void Machine::delay(int64_t duration_us) {
  const int64_t until_us = now_us() + duration_us;
  for (int64_t now = now_us(); now < until_us; now = now_us()) rest(std::min(kTurn_us, until_us - now));
}

void Machine::take_signals() {
  if (wifi_signal != 0) {
    radio.set_up(wifi_signal == SIGUSR2, now_us());
    wifi_signal = 0;
  }
  if (end_signal == 0) return;
  std::printf("%s\n", stats().c_str());
  std::fflush(stdout);
  ::_exit(0);
}

void Machine::take_commands() {
  char bytes[256];
  const ssize_t count = ::read(STDIN_FILENO, bytes, sizeof bytes);
  if (count <= 0) {
    has_stdin_ = false;
    return;
  }
  typed_.append(bytes, static_cast<size_t>(count));
  for (size_t end = typed_.find('\n'); end != std::string::npos; end = typed_.find('\n')) {
    obey(typed_.substr(0, end));
    typed_.erase(0, end + 1);
  }
}

void Machine::obey(const std::string& command) {
  int64_t pause_us = 0;
  if (command == "wifi down")
    radio.set_up(false, now_us());
  else if (command == "wifi up")
    radio.set_up(true, now_us());
  else if (command == "radio mute")
    radio.set_mute(true);
  else if (command == "radio clear")
    radio.set_mute(false);
  else if (command == "connect refuse")
    radio.dialling = Dialling::kRefuse;
  else if (command == "connect hang")
    radio.dialling = Dialling::kHang;
  else if (command == "connect normal")
    radio.dialling = Dialling::kNormal;
  else if (command.compare(0, 5, "wait ") == 0)
    pause_us = std::atoll(command.c_str() + 5) * 1000;
  else if (command != "stats")
    std::printf("{\"event\": \"command.unknown\"}\n");
  answer_at_us_ = now_us() + pause_us;
}

void Machine::answer() {
  answer_at_us_ = 0;
  std::printf("%s\n", stats().c_str());
  std::fflush(stdout);
}

std::string Machine::stats() const {
  char text[512];
  std::snprintf(
      text, sizeof text,
      "{\"event\": \"stats\", \"uart_received_bytes\": %llu, \"uart_overflowed_bytes\": %llu, "
      "\"uart_transmitted_bytes\": %llu, \"uart_lost_bytes\": %llu, \"wifi_begins\": %u, \"connects\": %u, "
      "\"tcp_writes\": %llu, \"closed_in_silence\": %zu}",
      static_cast<unsigned long long>(uart.received_bytes), static_cast<unsigned long long>(uart.overflowed_bytes),
      static_cast<unsigned long long>(uart.transmitted_bytes), static_cast<unsigned long long>(uart.lost_bytes),
      radio.begins, radio.connects, static_cast<unsigned long long>(radio.sent_writes), radio.closed_in_silence());
  return text;
}

}  // namespace standin
