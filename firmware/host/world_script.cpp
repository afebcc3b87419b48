#include "world_script.h"

#include <string.h>

#include "../due/src/messages.h"
#include "world_parameters.h"

namespace hostlink {

namespace {

const uint32_t kCommandMs = 100;
const uint32_t kConnectMs = 500;
const uint16_t kTopicsRequest = 0;
const uint16_t kTime = 10;
const uint16_t kVelocity = 100;  // the first topic to the device
const size_t kLongestLine = 120;

class Runner {
 public:
  Runner(RobotInWorld& robot, RowSink sink, void* context) : robot_(robot), sink_(sink), context_(context) {}

  bool run_line(const char* line) {
    if (strchr(line, '=') != nullptr) return read_world(line, parameters_) == 0;
    begin();
    if (strncmp(line, "drive ", 6) == 0) return drive(line + 6);
    double ms = 0.0;
    if (strncmp(line, "wait ", 5) != 0 || !is_end(read_number(line + 5, ms))) return false;
    pass(static_cast<uint32_t>(ms));
    return true;
  }

 private:
  // At the first line that is not a parameter: the world is as it was read, and the host connects.
  void begin() {
    if (has_begun_) return;
    has_begun_ = true;
    robot_.world().be(parameters_);
    send(kTopicsRequest, nullptr, 0);
    pass(kConnectMs);
  }

  bool drive(const char* words) {
    double values[3] = {};
    for (size_t i = 0; i < 3 && words != nullptr; ++i) {
      words = read_number(words, values[i]);
      if (words != nullptr && *words == ' ') ++words;
    }
    if (!is_end(words)) return false;
    uint8_t twist[kTwistBytes] = {};
    write_float64(twist, static_cast<float>(values[0]));
    write_float64(twist + 5 * kFloat64Bytes, static_cast<float>(values[1]));
    for (uint32_t left_ms = static_cast<uint32_t>(values[2]); left_ms > 0;) {
      const uint8_t time[8] = {};
      send(kVelocity, twist, sizeof twist);
      send(kTime, time, sizeof time);  // a host that answers: without answers the device falls silent after 11 s
      const uint32_t now_ms = left_ms < kCommandMs ? left_ms : kCommandMs;
      pass(now_ms);
      left_ms -= now_ms;
    }
    return true;
  }

  void pass(uint32_t ms) {
    for (; ms > 0; --ms) {
      robot_.pass();
      UartOut& out = robot_.board().to_host();
      for (size_t size = 0; (size = out.ready(robot_.board().line_us())) > 0;) out.drop(size);
      if (++passed_ms_ % kScriptRowMs != 0) continue;
      robot_.report(row_);
      sink_(context_, row_);
    }
  }

  void send(uint16_t id, const uint8_t* payload, uint8_t size) {
    const uint8_t head[7] = {0xFF, 0xFE, size, 0, static_cast<uint8_t>(~size), static_cast<uint8_t>(id), 0};
    uint8_t sum = static_cast<uint8_t>(id);
    for (uint8_t i = 0; i < size; ++i) sum = static_cast<uint8_t>(sum + payload[i]);
    for (uint8_t byte : head) put(byte);
    for (uint8_t i = 0; i < size; ++i) put(payload[i]);
    put(static_cast<uint8_t>(~sum));
  }

  void put(uint8_t byte) { robot_.board().from_host().put_on_line(byte, robot_.board().line_us()); }
  static bool is_end(const char* at) { return at != nullptr && *at == '\0'; }

  RobotInWorld& robot_;
  RowSink sink_;
  void* context_;
  WorldParameters parameters_;
  bool has_begun_ = false;
  uint32_t passed_ms_ = 0;
  double row_[RobotInWorld::kColumns] = {};
};

}  // namespace

uint32_t run_script(RobotInWorld& robot, const char* text, RowSink sink, void* context) {
  Runner runner(robot, sink, context);
  char line[kLongestLine];
  for (uint32_t number = 1; *text != '\0'; ++number) {
    const size_t size = strcspn(text, "\n");
    if (size >= sizeof line) return number;
    memcpy(line, text, size);
    line[size] = '\0';
    if (size > 0 && line[0] != '#' && !runner.run_line(line)) return number;
    text += size;
    if (*text == '\n') ++text;
  }
  return 0;
}

}  // namespace hostlink
