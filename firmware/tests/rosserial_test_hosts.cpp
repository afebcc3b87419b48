// Behaviour of rosserial_python and rosserial_server that differs from hostlink: docs/protocol.md.
#include <string.h>

#include "rosserial_test.h"

namespace {

typedef ros::BufferedNode<25, 25, 280, 280> UnoNode;

// A host on a UART of 57600 baud, a turn each millisecond; it answers requests for the time, and nothing else.
struct UartHost : public TestLink {
  size_t answered = 0;
  uint32_t heard_at_ms = 0;
  uint32_t longest_silence_ms = 0;

  template <class N>
  void turn(N& node, uint32_t ms) {
    for (; ms > 0; --ms) {
      room = now_ms % 4 == 0 ? 5 : 6;
      const size_t before = to_host_size;
      node.spinOnce();
      ++now_ms;
      if (to_host_size == before) continue;
      const uint32_t silence_ms = now_ms - heard_at_ms;
      longest_silence_ms = silence_ms > longest_silence_ms ? silence_ms : longest_silence_ms;
      heard_at_ms = now_ms;
      for (; sent_id(answered) >= 0; ++answered) {
        if (sent_id(answered) == 10) put_time(1000, 0);
      }
    }
  }
  // All frames are whole ones.
  size_t count(int id) const {
    size_t found = 0;
    size_t number = 0;
    for (; sent_id(number) >= 0; ++number) found += sent_id(number) == id ? 1 : 0;
    return found;
  }
};

// rosserial_server ends a connection a second after its request without topics. Twenty of them do not fit at once.
void test_twenty_topics_are_announced_within_a_second_beside_messages_and_lines() {
  UartHost host;
  UnoNode node(host);
  Number number;
  ros::Publisher publisher("numbers", &number);
  node.advertise(publisher);
  static const char* const kNames[19] = {"a", "b", "c", "d", "e", "f", "g", "h", "i", "j",
                                         "k", "l", "m", "n", "o", "p", "q", "r", "s"};
  static ros::Publisher others[19] = {
      {kNames[0], &number},  {kNames[1], &number},  {kNames[2], &number},  {kNames[3], &number},  {kNames[4], &number},
      {kNames[5], &number},  {kNames[6], &number},  {kNames[7], &number},  {kNames[8], &number},  {kNames[9], &number},
      {kNames[10], &number}, {kNames[11], &number}, {kNames[12], &number}, {kNames[13], &number}, {kNames[14], &number},
      {kNames[15], &number}, {kNames[16], &number}, {kNames[17], &number}, {kNames[18], &number}};
  for (ros::Publisher& other : others) node.advertise(other);
  for (int times = 0; times < 2; ++times) {  // the second time while it publishes
    host.turn(node, 200);                    // to the end of a frame
    host.clear();
    host.answered = 0;
    host.request_topics();
    for (int ms = 0; ms < 1000; ++ms) {
      host.turn(node, 1);
      publisher.publish(&number);
      if (ms % 8 == 0) node.loginfo("a line");
    }
    CHECK(node.connected());
    CHECK(host.count(0) == 20);
  }
}

// rosserial_server ends a connection after five seconds of silence.
void test_a_board_that_publishes_nothing_is_heard_every_five_seconds() {
  UartHost host;
  UnoNode node(host);
  ros::Subscriber<Number> subscriber("a", [](const Number&) {});
  node.subscribe(subscriber);
  host.request_topics();
  host.turn(node, 100);
  host.longest_silence_ms = 0;
  host.turn(node, 40000);
  CHECK(node.connected());
  CHECK(host.longest_silence_ms < 2600);
}

// rosserial_python requests the topics two seconds after the connection; until then nothing may be sent of them.
void test_a_host_that_begins_late() {
  UartHost host;
  UnoNode node(host);
  Number number;
  ros::Publisher publisher("numbers", &number);
  node.advertise(publisher);
  for (int turn = 0; turn < 2100; ++turn) {
    CHECK(publisher.publish(&number) == 0);
    host.turn(node, 1);
  }
  CHECK(host.to_host_size == 0);
  host.request_topics();
  host.turn(node, 100);
  CHECK(publisher.publish(&number) == 4);
}

// rosserial_server does not answer a call that has failed.
void test_an_empty_answer_is_no_answer() {
  UartHost host;
  UnoNode node(host);
  ros::ServiceClient<Number, Number> client("double");
  node.serviceClient(client);
  host.request_topics();
  host.turn(node, 100);
  Number number;
  int answers = 0;
  int failures = 0;
  CHECK(client.begin(number,
                     [&answers, &failures](const Number* response) { ++(response == nullptr ? failures : answers); }));
  host.put_frame(100, nullptr, 0);
  host.turn(node, 1100);
  CHECK(answers == 0 && failures == 1);
}

// Both send a message that is larger than the board's buffer; the frame after it is not lost.
void test_messages_larger_than_the_buffer() {
  UartHost host;
  UnoNode node(host);
  int32_t got = 0;
  ros::Subscriber<Number> subscriber("a", [&got](const Number& number) { got = number.data; });
  node.subscribe(subscriber);
  host.request_topics();
  host.turn(node, 100);
  static uint8_t large[1022];
  memset(large, 0xFF, sizeof large);  // the worst: each byte may start a frame
  host.put_frame(100, large, sizeof large);
  host.put_number(100, 8);
  host.turn(node, 300);
  CHECK(got == 8 && node.connected());
}

}  // namespace

void run_hosts_tests() {
  RUN(test_twenty_topics_are_announced_within_a_second_beside_messages_and_lines);
  RUN(test_a_board_that_publishes_nothing_is_heard_every_five_seconds);
  RUN(test_a_host_that_begins_late);
  RUN(test_an_empty_answer_is_no_answer);
  RUN(test_messages_larger_than_the_buffer);
}
