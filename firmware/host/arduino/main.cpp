// esp8266_native: the unmodified sketch as a process. Prints where its UART is; takes commands on stdin (machine.cpp).
#include <cstdio>
#include <cstdlib>
#include <exception>
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
    "  --unpaced            bytes pass the UART as fast as they come (default: 10 bits a byte at the sketch's baud rate)\n"
    "  --boot-noise N       N bytes of garbage on the UART at power-up\n"
    "  --wait-for-device    power up when the other end of the UART is there\n"
    "  --swap               UART on GPIO15 and GPIO13\n"
    "  --join-ms N --connect-ms N --send-buffer N --write-limit N   how unkind the radio is\n"
    "commands on stdin: wifi up|down, radio mute|clear, connect normal|refuse|hang, wait MS, stats; each is\n"
    "answered with a line of counters. SIGUSR1, SIGUSR2: WiFi down, up\n";

standin::Options parse(int argc, char** argv) {
  standin::Options options;
  const std::map<std::string, bool*> flags = {
      {"--wait-for-device", &options.waits_for_device}, {"--swap", &options.is_uart_swapped}};
  for (int i = 1; i < argc; ++i) {
    const std::string name = argv[i];
    if (const auto flag = flags.find(name); flag != flags.end()) {
      *flag->second = true;
      continue;
    }
    if (name == "--unpaced") {
      options.is_uart_paced = false;
      continue;
    }
    if (i + 1 == argc) throw std::runtime_error("unknown, or without a value: " + name);
    const std::string value = argv[++i];
    if (name == "--uart") options.uart = value;
    else if (name == "--boot-noise") options.boot_noise_bytes = static_cast<unsigned>(std::stoul(value));
    else if (name == "--join-ms") options.radio.join_ms = static_cast<unsigned>(std::stoul(value));
    else if (name == "--connect-ms") options.radio.connect_ms = static_cast<unsigned>(std::stoul(value));
    else if (name == "--send-buffer") options.radio.send_buffer_bytes = std::stoul(value);
    else if (name == "--write-limit") options.radio.write_limit_bytes = std::stoul(value);
    else if (const size_t colon = value.rfind(':'); name == "--server" && colon != std::string::npos) {
      options.server = value.substr(0, colon);
      options.server_port = static_cast<uint16_t>(std::stoul(value.substr(colon + 1)));
    } else throw std::runtime_error("unknown: " + name + " " + value);
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
