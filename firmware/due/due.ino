// The paper's robot on an Arduino Due: wiring only. src/ has the logic, src/board/ the board.
//
// Arduino IDE: open this file, board "Arduino Due (Programming Port)", upload. Pins and wiring: docs/build-robot.md.

#include <ros.h>  // include path of the library: firmware/rosserial

#include "src/board/due_board.h"
#include "src/robot.h"

static hostlink::DueBoard board;
static hostlink::Robot robot(board);  // its topics are /robot_0/...; for a second robot: robot(board, "/robot_1/")

void setup() {
  board.begin();
  robot.setup();
}

void loop() {
  board.run();
  const uint32_t wait_ms = robot.loop();
  if (wait_ms > 0) delay(wait_ms);  // with the paper's retry clause: robot(board, "/robot_0/", ros::Retry::kPaper)
}
