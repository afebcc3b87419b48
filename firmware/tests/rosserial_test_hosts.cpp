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

// The UART of an Uno: a ring of 63 bytes, of which each millisecond sends 5. Each look at the clock takes a
// millisecond.
struct RingLink : public TestLink {
  bool is_uart = true;

  bool drains() override { return is_uart; }
  uint32_t milliseconds() override {
    pass(1);
    return now_ms;
  }
  void pass(uint32_t ms) {
    now_ms += ms;
    if (is_uart) room = room + 5 * ms < 63 ? room + 5 * ms : 63;
  }
};

// A sketch of two topics: each loop is a spinOnce(), two messages that are longer than the ring, and something slow.
struct SlowSketch {
  RingLink link;
  UnoNode node{link};
  Words words;
  Number number;
  ros::Publisher large{"a_topic_with_a_long_name_of_its_own", &words};
  ros::Publisher small{"small", &number};
  bool has_sent_both = false;  // in the last loop, whole
  uint32_t waited_ms = 0;      // in the last loop

  SlowSketch() {
    link.room = 63;
    words.text =
        "one hundred characters and more, which take longer than the ring of an UART holds: 48.1 % of 1013 hPa";
    node.advertise(large);
    node.advertise(small);
  }
  void loop(uint32_t slow_ms) {
    const uint32_t began_ms = link.now_ms;
    node.spinOnce();
    link.clear();
    large.publish(&words);
    small.publish(&number);
    has_sent_both = link.sent_id(0) == 125 && link.sent_id(1) == 126 && link.sent_frames() == 2;
    waited_ms = link.now_ms - began_ms;
    link.pass(slow_ms);
  }
};

void test_a_slow_sketch_announces_and_publishes_in_one_turn() {
  const uint32_t times_ms[] = {100, 500, 2000, 8000};
  for (const uint32_t slow_ms : times_ms) {
    SlowSketch sketch;
    sketch.loop(slow_ms);
    sketch.link.request_topics();
    sketch.loop(slow_ms);
    CHECK(sketch.node.connected());
    CHECK(sketch.has_sent_both || slow_ms == 100);  // the topics took the time of the shortest loop
    for (int loops = 0; loops < 5; ++loops) {
      sketch.link.put_time(1000, 0);
      sketch.loop(slow_ms);
      CHECK(sketch.has_sent_both);
      CHECK(sketch.waited_ms < 50);
    }
    CHECK(sketch.node.dropped_to_host() == 0);
  }
}

void test_a_line_that_takes_nothing_is_waited_for_half_a_turn_and_a_second_at_most() {
  struct StuckLink : public RingLink {
    size_t write(const uint8_t*, size_t) override { return 0; }
  };
  const uint32_t times_ms[] = {0, 5, 20, 100, 1000, 8000};
  for (const uint32_t slow_ms : times_ms) {
    StuckLink link;
    UnoNode node(link);
    Number number;
    ros::Publisher publisher("numbers", &number);
    node.advertise(publisher);
    node.spinOnce();
    link.request_topics();
    for (int loops = 0; loops < 20; ++loops) {
      link.put_time(1000, 0);
      const uint32_t began_ms = link.now_ms;
      node.spinOnce();
      for (int times = 0; times < 10; ++times) publisher.publish(&number);
      const uint32_t waited_ms = link.now_ms - began_ms;
      const uint32_t looks_ms = 20;
      CHECK(waited_ms <= slow_ms + looks_ms && waited_ms <= 1000 + looks_ms);
      link.pass(slow_ms);
    }
  }
}

void test_a_fast_loop_and_a_network_are_not_waited_for() {
  for (int times = 0; times < 2; ++times) {
    SlowSketch sketch;
    sketch.link.is_uart = times == 0;
    const uint32_t slow_ms = times == 0 ? 3 : 2000;
    sketch.loop(slow_ms);  // the time since the start was no loop
    sketch.link.request_topics();
    for (int loops = 0; loops < 100; ++loops) {
      sketch.link.put_time(1000, 0);
      sketch.loop(slow_ms);
      CHECK(sketch.waited_ms < 20);  // each look at the clock is a millisecond
    }
    CHECK(sketch.node.connected());
  }
}

// A network takes whole messages: they do not wait for the next turn.
void test_a_slow_sketch_on_a_network_publishes_at_once() {
  SlowSketch sketch;
  sketch.link.is_uart = false;
  sketch.link.request_topics();
  for (int loops = 0; loops < 5; ++loops) {
    sketch.link.put_time(1000, 0);
    sketch.link.room = 10000;
    sketch.loop(2000);
    CHECK(sketch.has_sent_both);
  }
}

void test_a_message_that_never_fits_is_told_once_to_each_host() {
  TestLink link;
  UnoNode node(link);
  Words words;
  float values[100] = {};
  words.values = values;
  words.values_length = 100;
  ros::Publisher odom("odom", &words);
  node.advertise(odom);
  for (int hosts = 0; hosts < 2; ++hosts) {
    connect(link, node);
    for (int times = 0; times < 3; ++times) {
      CHECK(odom.publish(&words) == -1);
      node.spinOnce();
    }
    CHECK(link.sent_frames() == 1 && link.sent_id(0) == 7);
    const uint8_t* line = nullptr;
    size_t size = 0;
    link.sent(0, line, size);
    const char text[] = "message larger than buffer: odom";
    CHECK(size == 5 + sizeof text - 1 && line[0] == 3 && memcmp(line + 5, text, size - 5) == 0);
  }
  CHECK(node.dropped_to_host() == 6);
}

}  // namespace

void run_hosts_tests() {
  RUN(test_a_slow_sketch_announces_and_publishes_in_one_turn);
  RUN(test_a_line_that_takes_nothing_is_waited_for_half_a_turn_and_a_second_at_most);
  RUN(test_a_fast_loop_and_a_network_are_not_waited_for);
  RUN(test_a_slow_sketch_on_a_network_publishes_at_once);
  RUN(test_a_message_that_never_fits_is_told_once_to_each_host);
  RUN(test_twenty_topics_are_announced_within_a_second_beside_messages_and_lines);
  RUN(test_a_board_that_publishes_nothing_is_heard_every_five_seconds);
  RUN(test_a_host_that_begins_late);
  RUN(test_an_empty_answer_is_no_answer);
  RUN(test_messages_larger_than_the_buffer);
}
