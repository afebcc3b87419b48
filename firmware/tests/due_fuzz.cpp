// libFuzzer: any bytes, in pieces, at any times, into the node and the whole robot; afterwards a good frame is found.
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include "../due/src/robot.h"

namespace {

struct FuzzHal : public hostlink::Hal {
  uint32_t now_us = 0;
  const uint8_t* at = nullptr;
  size_t left = 0;
  int16_t pwm = 0;

  uint32_t milliseconds() override { return now_us / 1000; }
  uint32_t micros() override { return now_us; }
  int read() override {
    if (left == 0) return -1;
    --left;
    return *at++;
  }
  size_t write(const uint8_t*, size_t size) override { return size / 2 + 1 < size ? size / 2 + 1 : size; }
  void drive(int16_t left_pwm, int16_t right_pwm) override {
    if (left_pwm > 4095 || left_pwm < -4095 || right_pwm > 4095 || right_pwm < -4095) abort();
    pwm = left_pwm;
  }
  void edges(uint32_t& left_edges, uint32_t& right_edges) override { left_edges = right_edges = now_us / 10000; }
};

void feed(FuzzHal& hal, hostlink::Robot& robot, const uint8_t* bytes, size_t size) {
  hal.at = bytes;
  hal.left = size;
  while (hal.left > 0) robot.loop();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  FuzzHal hal;
  hostlink::Robot robot(hal, "/robot_0/", static_cast<ros::Retry>(size % 3));
  robot.setup();
  while (size > 1) {  // each piece: how long to wait, how many bytes
    hal.now_us += data[0] * 1000u;
    const size_t wanted = 1 + data[1] % 64;
    data += 2;
    size -= 2;
    const size_t piece = wanted < size ? wanted : size;
    feed(hal, robot, data, piece);
    data += piece;
    size -= piece;
  }
  for (int turn = 0; turn < 12; ++turn) {  // silence: the wheels stop, and no half frame waits
    hal.now_us += 300000;
    robot.loop();
  }
  if (hal.pwm != 0) abort();
  const uint8_t topics_request[] = {0xFF, 0xFE, 0, 0, 0xFF, 0, 0, 0xFF};
  feed(hal, robot, topics_request, sizeof topics_request);
  if (!robot.node().is_configured()) abort();
  return 0;
}
