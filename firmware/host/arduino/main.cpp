// esp8266_native: the unmodified sketch as a process. Prints where its UART is; reads commands on stdin (machine.cpp).
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <functional>
#include <map>
#include <stdexcept>
#include <string>

#include "Arduino.h"
#include "machine.h"

void setup();
void loop();

namespace {
constexpr char kUsage[] =
    "usage: esp8266_native [--uart listen:PORT|connect:HOST:PORT|pty] [--server HOST:PORT]\n"
    "  --unpaced            bytes pass the UART as fast as they come (default: 10 bits a byte at the sketch's baud "
    "rate)\n"
    "  --key TEXT           the key that host and device share\n"
    "  --boot-noise N       N bytes of garbage on the UART at power-up\n"
    "  --wait-for-device    power up when the other end of the UART is there\n"
    "  --signal DBM         how strong the WiFi is, -67 for example (default: it is not known)\n"
    "  --swap               UART on GPIO15 and GPIO13\n"
    "  --join-ms N --connect-ms N --send-buffer N --write-limit N   how unkind the radio is\n"
    "commands on stdin: wifi up|down, radio mute|clear, connect normal|refuse|hang, wait MS, stats; each is\n"
    "answered with a line of counters. SIGUSR1, SIGUSR2: WiFi down, up\n";

void set_server(standin::Options& options, const std::string& where) {
  const size_t colon = where.rfind(':');
  if (colon == std::string::npos) throw std::runtime_error("not HOST:PORT: " + where);
  options.server = where.substr(0, colon);
  options.server_port = static_cast<uint16_t>(std::stoul(where.substr(colon + 1)));
}

standin::Options parse(int argc, char** argv) {
  using Value = const std::string&;
  standin::Options options;
  standin::RadioOptions& radio = options.radio;
  const auto number = [](Value value) { return static_cast<unsigned>(std::stoul(value)); };
  const std::map<std::string, std::function<void()>> flags = {
      {"--help",
       [] {
         std::fputs(kUsage, stdout);
         std::exit(0);
       }},
      {"--unpaced", [&] { options.is_uart_paced = false; }},
      {"--wait-for-device", [&] { options.waits_for_device = true; }},
      {"--swap", [&] { options.is_uart_swapped = true; }}};
  const std::map<std::string, std::function<void(Value)>> settings = {
      {"--uart", [&](Value value) { options.uart = value; }},
      {"--server", [&](Value value) { set_server(options, value); }},
      {"--key", [&](Value value) { options.key = value; }},
      {"--boot-noise", [&](Value value) { options.boot_noise_bytes = number(value); }},
      {"--signal", [&](Value value) { radio.signal_dbm = std::stoi(value); }},
      {"--join-ms", [&](Value value) { radio.join_ms = number(value); }},
      {"--connect-ms", [&](Value value) { radio.connect_ms = number(value); }},
      {"--send-buffer", [&](Value value) { radio.send_buffer_bytes = number(value); }},
      {"--write-limit", [&](Value value) { radio.write_limit_bytes = number(value); }}};
  for (int i = 1; i < argc; ++i) {
    const std::string name = argv[i];
    if (flags.count(name) > 0) {
      flags.at(name)();
    } else if (settings.count(name) > 0 && i + 1 < argc) {
      settings.at(name)(argv[++i]);
    } else {
      throw std::runtime_error("unknown, or without a value: " + name);
    }
  }
  return options;
}
}  // namespace

int main(int argc, char** argv) {
  try {
    standin::machine().power_up(parse(argc, argv));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "esp8266_native: %s\n%s", error.what(), kUsage);
    return 2;
  }
  setup();
  while (true) {
    loop();
    standin::machine().rest(0);  // the core lets the SDK run between two turns
  }
}
