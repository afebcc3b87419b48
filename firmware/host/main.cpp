// due_native: the Due's firmware as a process: its UART is a TCP connection, as slow as the line in both directions,
// its motors are a model.
//
//   due_native HOST PORT [BAUD [WORLD]]
//
// The process connects, reconnects, and runs until it is killed. BAUD 0: as fast as TCP. WORLD: a file of lines
// name=value (world_parameters.h).
//
// Twice a second it writes a line: loops, wheel speeds (ticks/s), bytes lost in the UART, messages received, sent and
// dropped, the true pose of the robot, and when it last received a message and last rolled.
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "../due/src/robot.h"
#include "activity_recorder.h"
#include "uart_out.h"
#include "uart_ring.h"
#include "world_hal.h"

namespace {

const int kTurnMs = 1;
const uint32_t kReconnectMs = 200;
const uint32_t kReportMs = 500;
const uint32_t kPaperBaud = 38400;

class PosixHal : public hostlink::WorldHal {
 public:
  PosixHal(const sockaddr_in& host, uint32_t baud) : baud_(baud), ring_(baud), out_(baud), host_(host) {}

  uint32_t milliseconds() override { return static_cast<uint32_t>(now_us() / 1000); }
  uint32_t micros() override { return static_cast<uint32_t>(now_us()); }
  int read() override { return ring_.read(); }

  size_t write(const uint8_t* data, size_t size) override {
    if (socket_ < 0) return size;  // a UART without a reader accepts everything
    const size_t accepted = out_.put(data, size, micros());
    send();
    return accepted;
  }

  // Work of the hardware between two turns of the loop.
  void run() {
    if (socket_ < 0) connect_again();
    uint8_t bytes[512];
    while (socket_ >= 0 && ring_.line_room() >= sizeof bytes) {
      const ssize_t got = ::recv(socket_, bytes, sizeof bytes, MSG_DONTWAIT);
      if (got <= 0) {
        if (got == 0 || (errno != EAGAIN && errno != EWOULDBLOCK)) hang_up();
        break;
      }
      for (ssize_t i = 0; i < got; ++i) ring_.put_on_line(bytes[i], micros());
    }
    ring_.run_until(micros());
    send();
    world_.run_until(micros());
  }

  void wait() {
    pollfd wanted = {socket_, POLLIN, 0};
    ::poll(&wanted, socket_ >= 0 ? 1 : 0, kTurnMs);
  }

  hostlink::World& world() { return world_; }
  uint32_t lost() const { return ring_.lost(); }

 private:
  static uint64_t now_us() {
    timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return static_cast<uint64_t>(now.tv_sec) * 1000000u + static_cast<uint64_t>(now.tv_nsec) / 1000u;
  }

  // Bytes that have passed the line go to the host; bytes that a full socket does not accept block the line.
  void send() {
    size_t size = 0;
    while (socket_ >= 0 && (size = out_.ready(micros())) > 0) {
      const ssize_t accepted = ::send(socket_, out_.data(), size, MSG_NOSIGNAL | MSG_DONTWAIT);
      if (accepted > 0) {
        out_.drop(static_cast<size_t>(accepted));
      } else {
        if (errno != EAGAIN && errno != EWOULDBLOCK) hang_up();
        return;
      }
    }
  }

  void connect_again() {
    if (milliseconds() - tried_at_ms_ < kReconnectMs) return;
    tried_at_ms_ = milliseconds();
    const int made = ::socket(AF_INET, SOCK_STREAM, 0);
    if (made < 0) return;
    if (::connect(made, reinterpret_cast<const sockaddr*>(&host_), sizeof host_) != 0) {
      ::close(made);
      return;
    }
    const int yes = 1;
    ::setsockopt(made, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    socket_ = made;
  }

  void hang_up() {
    ::close(socket_);
    socket_ = -1;
    out_ = hostlink::UartOut(baud_);  // bytes for that host are not for another one
  }

  uint32_t baud_;
  hostlink::UartRing ring_;
  hostlink::UartOut out_;
  sockaddr_in host_;
  int socket_ = -1;
  uint32_t tried_at_ms_ = 0;
};

const char* const kUsage = "usage: due_native HOST PORT [BAUD [WORLD]]";
const size_t kMostWorldBytes = 65536;

// Returns whether it succeeded; otherwise it has written the reason.
bool read_world_file(const char* path, hostlink::WorldParameters& parameters) {
  static char text[kMostWorldBytes];
  FILE* file = fopen(path, "r");
  if (file == nullptr) {
    fprintf(stderr, "due_native: %s: %s\n", path, strerror(errno));
    return false;
  }
  const size_t size = fread(text, 1, sizeof text - 1, file);
  fclose(file);
  text[size] = '\0';
  const uint32_t wrong = hostlink::read_world(text, parameters);
  if (wrong == 0) return true;
  fprintf(stderr,
          "due_native: %s: line %lu is no number of a world: its names are in firmware/host/world_parameters.h\n", path,
          static_cast<unsigned long>(wrong));
  return false;
}

}  // namespace

int main(int count, char** words) {
  if (count < 3) {
    fprintf(stderr, "%s\n", kUsage);
    return 2;
  }
  sockaddr_in host = {};
  host.sin_family = AF_INET;
  host.sin_port = htons(static_cast<uint16_t>(atoi(words[2])));
  if (inet_pton(AF_INET, words[1], &host.sin_addr) != 1) {
    fprintf(stderr, "due_native: %s is no IPv4 address\n", words[1]);
    return 2;
  }
  PosixHal hal(host, count > 3 ? static_cast<uint32_t>(atoi(words[3])) : kPaperBaud);
  hostlink::WorldParameters parameters;
  if (count > 4 && !read_world_file(words[4], parameters)) return 2;
  hal.world().be(parameters);
  hostlink::Robot robot(hal);
  robot.setup();
  hostlink::ActivityRecorder activity;
  uint32_t reported_at_ms = hal.milliseconds();
  unsigned long loops = 0;
  for (;;) {
    hal.run();
    robot.loop();
    activity.update(hal.world(), robot.node().delivered(), hal.milliseconds());
    ++loops;
    if (hal.milliseconds() - reported_at_ms >= kReportMs) {
      reported_at_ms += kReportMs;
      const hostlink::World& world = hal.world();
      const hostlink::RobotNode& node = robot.node();
      printf(
          "loops %lu left %.1f right %.1f lost %lu got %lu sent %lu dropped %lu x_mm %.0f y_mm %.0f theta_mrad %.0f "
          "battery_mv %.0f "
          "got_ms %lu rolled_ms %lu rolled_mm %.0f\n",
          loops, world.left().speed_ticks_s(), world.right().speed_ticks_s(), static_cast<unsigned long>(hal.lost()),
          static_cast<unsigned long>(node.delivered()), static_cast<unsigned long>(node.published()),
          static_cast<unsigned long>(node.dropped_from_host() + node.dropped_to_host()), world.pose().x_m * 1000.0,
          world.pose().y_m * 1000.0, world.pose().theta_rad * 1000.0, world.battery_v() * 1000.0,
          static_cast<unsigned long>(activity.got_at_ms()), static_cast<unsigned long>(activity.rolled_at_ms()),
          world.rolled_m() * 1000.0);
      fflush(stdout);
    }
    hal.wait();
  }
}
