// Two boards: a node behind a passthrough, and the host in front of it.
#include <hostlink/command_watchdog.h>
#include <hostlink/link_passthrough.h>

#include "rosserial_test.h"

namespace {

typedef hostlink::LinkPassthrough<64> SmallPassthrough;

void move_sent(TestLink& from, TestLink& to) {
  to.put(from.to_host, from.to_host_size);
  from.clear();
}

void test_bytes_pass_in_their_order() {
  TestLink uart, tcp;
  SmallPassthrough passthrough(uart, tcp);
  for (int number = 0; number < 40; ++number) {
    uart.put_number(125, number);
    tcp.put_number(100, -number);
  }
  const size_t size = uart.from_host_size;
  CHECK(tcp.from_host_size == size);
  for (int turn = 0; turn < 200; ++turn) {
    uart.room = tcp.room = 7;  // neither accepts a whole frame at once
    passthrough.spin();
    passthrough.spin();
  }
  CHECK(uart.to_host_size == size && memcmp(uart.to_host, tcp.from_host, size) == 0);
  const size_t passed = tcp.to_host_size + passthrough.dropped();
  CHECK(passed == size);
}

void test_a_device_that_nobody_hears_is_read_and_dropped() {
  TestLink uart, tcp;
  SmallPassthrough passthrough(uart, tcp);
  tcp.room = 0;
  for (int number = 0; number < 20; ++number) uart.put_number(125, number);
  for (int turn = 0; turn < 10; ++turn) passthrough.spin();
  CHECK(uart.from_host_at == uart.from_host_size);
  CHECK(passthrough.dropped() == uart.from_host_size - 64);
}

void test_a_device_that_accepts_nothing_slows_the_host_down() {
  TestLink uart, tcp;
  SmallPassthrough passthrough(uart, tcp);
  uart.room = 0;
  for (int number = 0; number < 20; ++number) tcp.put_number(100, number);
  for (int turn = 0; turn < 10; ++turn) passthrough.spin();
  CHECK(tcp.from_host_at == 64);
}

void test_another_host_gets_nothing_of_what_was_said_before() {
  TestLink uart, tcp;
  SmallPassthrough passthrough(uart, tcp);
  uart.room = tcp.room = 0;
  uart.put_number(125, 1);
  tcp.put_number(100, 1);
  passthrough.spin();
  uart.put_number(125, 2);  // in the ring of the UART
  uart.room = tcp.room = kBytes;
  tcp.is_restarted = true;
  passthrough.spin();
  CHECK(tcp.to_host_size == 0 && passthrough.dropped() == 0);
  CHECK(uart.sent_frames() == 1 && uart.sent_id(0) == 11);
}

void test_a_passthrough_whose_link_says_it_wrote_more_than_it_was_given() {
  LyingLink uart;
  TestLink tcp;
  SmallPassthrough passthrough(uart, tcp);
  for (int number = 0; number < 20; ++number) tcp.put_number(100, number);
  for (int turn = 0; turn < 10; ++turn) passthrough.spin();
  uart.answer = 10;
  for (int turn = 0; turn < 40; ++turn) passthrough.spin();
  CHECK(tcp.from_host_at == tcp.from_host_size);
}

// Also when the connection ends in the middle of a command.
void test_motors_stop_when_the_passthrough_loses_the_host() {
  TestLink uart, tcp, board;
  SmallPassthrough passthrough(uart, tcp);
  TestNode node(board);
  bool rolls = false;
  hostlink::CommandWatchdog watchdog([&rolls]() { rolls = false; });
  ros::Subscriber<Number> command("command", [&](const Number&) { rolls = watchdog.feed(); });
  node.subscribe(command);
  node.attach(watchdog);
  tcp.request_topics();
  tcp.put_number(100, 1);
  passthrough.spin();
  move_sent(uart, board);
  node.spinOnce();
  node.spinOnce();
  CHECK(rolls && node.connected());
  const uint8_t half[] = {0xFF, 0xFE, 0x04, 0x00, 0xFB, 0x64, 0x00, 1};
  tcp.put(half, sizeof half);
  passthrough.spin();
  tcp.is_restarted = true;
  passthrough.spin();
  move_sent(uart, board);
  node.spinOnce();
  CHECK(!rolls && !node.connected());
}

// The part of a command that the device has must not swallow the stop, also without rescanning, like in ros_lib.
void test_a_stop_is_read_wherever_the_command_before_it_was_cut() {
  const ros::Retry retries[] = {ros::Retry::kNone, ros::Retry::kKeepState};
  for (const ros::Retry retry : retries) {
    for (size_t passed = 0; passed <= 12; ++passed) {
      TestLink uart, tcp, board;
      SmallPassthrough passthrough(uart, tcp);
      TestNode node(board, retry);
      int32_t received = 0;
      ros::Subscriber<Number> command("command", [&](const Number& number) { received = number.data; });
      node.subscribe(command);
      tcp.request_topics();
      passthrough.spin();
      tcp.put_number(100, 0x01020304);
      uart.room = passed;
      passthrough.spin();
      uart.room = kBytes;
      tcp.is_restarted = true;
      passthrough.spin();
      move_sent(uart, board);
      node.spinOnce();
      node.spinOnce();
      CHECK(!node.connected());
      CHECK(received == (passed == 12 ? 0x01020304 : 0));
      board.request_topics();
      node.spinOnce();
      CHECK(node.connected());
    }
  }
}

}  // namespace

void run_passthrough_tests() {
  RUN(test_bytes_pass_in_their_order);
  RUN(test_a_device_that_nobody_hears_is_read_and_dropped);
  RUN(test_a_device_that_accepts_nothing_slows_the_host_down);
  RUN(test_another_host_gets_nothing_of_what_was_said_before);
  RUN(test_a_passthrough_whose_link_says_it_wrote_more_than_it_was_given);
  RUN(test_motors_stop_when_the_passthrough_loses_the_host);
  RUN(test_a_stop_is_read_wherever_the_command_before_it_was_cut);
}
