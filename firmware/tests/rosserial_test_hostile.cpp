// Hosts that are broken, late or lost, a blocked loop, and sketches that misuse the library.
#include <hostlink/command_watchdog.h>
#include <ros/parameter.h>
#include <string.h>

#include "rosserial_test.h"

namespace {

// Parts of every robot sketch: a command, and what stops it.
struct TestRobot {
  TestLink link;
  TestNode node{link};
  int32_t speed = 0;
  hostlink::CommandWatchdog watchdog{[this]() { speed = 0; }};
  ros::Subscriber<Number> command{"command", [this](const Number& number) {
                                    if (watchdog.feed()) speed = number.data;
                                  }};

  TestRobot() {
    node.attach(watchdog);
    node.subscribe(command);
    connect(link, node);
  }
  void drive(int32_t wanted) {
    link.put_number(100, wanted);
    node.spinOnce();
  }
};

// A UART keeps the oldest bytes: bytes from before the pause of the loop may be followed by a stop that is lost.
void test_a_command_that_waited_for_a_loop_that_stood_still_drives_nothing() {
  TestRobot robot;
  robot.drive(5);
  CHECK(robot.speed == 5);
  robot.link.now_ms += 5000;
  robot.drive(6);
  CHECK(robot.speed == 0 && !robot.watchdog.is_running());
  const uint8_t* payload = nullptr;
  size_t size = 0;
  CHECK(robot.link.sent(0, payload, size) == 7);  // and the host's log has the reason
  robot.link.now_ms += 10;
  robot.drive(7);  // a new one does
  CHECK(robot.speed == 7);
  robot.link.now_ms += 400;  // slow, but shorter than the timeout
  robot.drive(8);
  CHECK(robot.speed == 8);
}

// More has waited than one turn reads.
void test_what_has_waited_stays_old_in_the_next_turns() {
  TestRobot robot;
  robot.node.spinOnce();
  robot.link.now_ms += 5000;
  for (int32_t number = 1; number < 200; ++number) robot.link.put_number(100, number);
  robot.node.spinOnce();
  robot.node.spinOnce();
  CHECK(robot.link.from_host_at > 1024 && robot.link.from_host_at < robot.link.from_host_size);
  CHECK(robot.speed == 0);
  while (robot.link.from_host_at < robot.link.from_host_size) robot.node.spinOnce();
  robot.node.spinOnce();
  robot.drive(9);
  CHECK(robot.speed == 9);
}

// The watchdog has a turn between two hosts, also if the next one connects at once.
void test_a_host_that_leaves_and_another_that_comes_in_one_turn() {
  TestRobot robot;
  robot.drive(5);
  robot.link.put_frame(11, nullptr, 0);
  robot.link.request_topics();
  robot.node.spinOnce();
  CHECK(robot.speed == 0);
  robot.node.spinOnce();
  CHECK(robot.node.connected());
  robot.drive(6);
  CHECK(robot.speed == 6);
  robot.link.is_restarted = true;
  robot.link.request_topics();
  robot.node.spinOnce();
  CHECK(robot.speed == 0 && !robot.node.connected());
  robot.node.spinOnce();
  CHECK(robot.node.connected());
}

// Both after a false start, so that they are read a second time, at once.
void test_a_host_that_leaves_behind_a_damaged_frame() {
  TestRobot robot;
  robot.drive(5);
  uint8_t inside[32] = {0xFF, 0xFE, 0, 0, 0xFF, 11, 0, 0xF4, 0xFF, 0xFE, 0, 0, 0xFF, 0, 0, 0xFF};
  robot.link.put_frame(6, inside, sizeof inside);
  robot.link.from_host[robot.link.from_host_size - 1] ^= 1;
  robot.node.spinOnce();
  CHECK(robot.speed == 0);
  robot.node.spinOnce();
  CHECK(robot.node.connected());
}

void test_a_link_that_says_it_wrote_more_than_it_was_given() {
  const size_t answers[] = {SIZE_MAX, 1000};  // -1, as many a board's function has it
  for (size_t answer : answers) {
    LyingLink link;
    TestNode node(link);
    ros::Subscriber<Number> a("a", [](const Number&) {});
    node.subscribe(a);
    link.answer = answer;
    link.request_topics();
    for (int turn = 0; turn < 10; ++turn) node.spinOnce();
    CHECK(node.connected());
  }
}

// A frame whose rest arrived while the loop was blocked.
void test_a_loop_that_stood_still_loses_no_frame() {
  TestRobot robot;
  int32_t got = 0;
  ros::Subscriber<Number> other("other", [&got](const Number& number) { got = number.data; });
  robot.node.subscribe(other);
  connect(robot.link, robot.node);
  const uint8_t first[] = {0xFF, 0xFE, 4, 0, 0xFB, 101, 0};
  const uint8_t rest[] = {7, 0, 0, 0, 0x93};
  robot.link.put(first, sizeof first);
  robot.node.spinOnce();
  robot.link.now_ms += 5000;
  robot.link.put(rest, sizeof rest);
  robot.node.spinOnce();
  CHECK(got == 7);
}

// Its lines are faster than the line.
void test_a_sketch_that_logs_in_each_turn_is_found_by_its_host() {
  TestLink link;
  TestNode node(link);
  Number number;
  ros::Publisher publisher("numbers", &number);
  node.advertise(publisher);
  link.room = 0;
  for (int turn = 0; turn < 50; ++turn) {
    node.loginfo("a line");
    node.spinOnce();
  }
  link.request_topics();
  for (int turn = 0; turn < 300 && !node.connected(); ++turn) {
    link.room = 4;
    node.loginfo("a line");
    node.spinOnce();
  }
  CHECK(node.connected());
}

void answer_double(const Number& request, Number& response) { response.data = 2 * request.data; }

// The board publishes more than the line takes.
void test_the_answer_of_a_service_does_not_go_for_messages() {
  TestLink link;
  TestNode node(link);
  Number number;
  ros::Publisher publisher("numbers", &number);
  ros::ServiceServer<Number, Number> server("double", &answer_double);
  node.advertise(publisher);
  node.advertiseService(server);
  connect(link, node);
  link.room = 0;
  link.put_number(100, 21);
  node.spinOnce();
  for (int message = 0; message < 100; ++message) publisher.publish(&number);
  CHECK(node.dropped_to_host() > 0);
  link.room = kBytes;
  node.spinOnce();
  bool is_answered = false;
  for (size_t frame = 0; frame < link.sent_frames(); ++frame) is_answered = is_answered || link.sent_id(frame) == 105;
  CHECK(is_answered);
}

void test_half_a_service_is_not_announced() {
  TestLink link;
  ros::BufferedNode<0, 3, 64, 128> node(link);
  ros::ServiceServer<Number, Number> server("double", &answer_double);
  ros::ServiceClient<Number, Number> client("double");
  CHECK(!node.advertiseService(server) && !node.serviceClient(client));
  link.request_topics();
  node.spinOnce();
  CHECK(link.sent_frames() == 1);  // the request for the time
}

// Both wait for an answer. A request in a callback cannot wait: it sends nothing either.
void test_nothing_is_requested_in_a_callback() {
  TestLink link;
  link.step_ms = 1;
  TestNode node(link);
  ros::ServiceClient<Number, Number> client("double");
  node.serviceClient(client);
  ros::Subscriber<Number> subscriber("a", [&client, &node](const Number&) {
    Number number;
    int value = 3;
    CHECK(!client.call(number, number) && !node.getParam("~x", &value));
  });
  node.subscribe(subscriber);
  connect(link, node);
  link.put_number(101, 1);
  node.spinOnce();
  CHECK(node.delivered() == 1 && link.sent_frames() == 0 && client.is_idle());
}

// A host that answers the n-th request for a parameter with n, at once or later.
struct ParameterHost : public TestLink {
  int32_t requests = 0;
  int32_t answers = 0;
  bool is_slow = false;

  size_t write(const uint8_t* bytes, size_t size) override {
    for (size_t at = 0; at + 8 <= size; at += 8u + bytes[at + 2]) requests += bytes[at + 5] == 6 ? 1 : 0;
    if (!is_slow) answer();
    return TestLink::write(bytes, size);
  }
  void answer() {
    for (; answers < requests; ++answers) {
      uint8_t payload[16];
      ros::Writer out(payload, sizeof payload);
      out.put(static_cast<uint32_t>(1));
      out.put(answers + 1);
      out.put(static_cast<uint64_t>(0));
      put_frame(6, payload, out.size());
    }
  }
};

// An answer does not name its parameter.
void test_a_late_answer_is_not_the_next_parameter_s() {
  ParameterHost host;
  host.step_ms = 1;
  TestNode node(host);
  connect(host, node);
  int value = 0;
  host.is_slow = true;
  CHECK(!node.getParam("~slow", &value, 1, 100));
  host.is_slow = false;
  host.answer();
  CHECK(node.getParam("~next", &value, 1, 100) && value == 2);
  host.is_slow = true;
  CHECK(!node.getParam("~missing", &value, 1, 100));
  host.answers = host.requests;  // rosserial_python answers nothing
  host.is_slow = false;
  const uint32_t began_ms = host.now_ms;
  CHECK(node.getParam("~next", &value) && value == 4);
  CHECK(host.now_ms - began_ms < 1200);
}

void test_a_parameter_is_waited_for_beside_the_ones_with_defaults() {
  ParameterHost host;
  host.step_ms = 1;
  TestNode node(host);
  ros::Parameter<int> first("first", 7);
  ros::Parameters parameters;
  parameters.add(first);
  node.attach(parameters);
  connect(host, node);  // the first is requested
  int second = 0;
  CHECK(node.getParam("second", &second) && second == 2);
  CHECK(first == 1);
}

// rosserial_python gives no answer for a parameter that is missing.
void test_the_parameters_behind_one_without_an_answer_are_requested() {
  ParameterHost host;
  TestNode node(host);
  ros::Parameter<int> missing("missing", 3), there("there", 4);
  ros::Parameters parameters;
  parameters.add(missing);
  parameters.add(there);
  node.attach(parameters);
  host.is_slow = true;
  connect(host, node);
  host.answers = host.requests;
  host.is_slow = false;
  for (int turn = 0; turn < 30; ++turn) {
    host.now_ms += 100;
    node.spinOnce();
  }
  CHECK(missing == 3 && there == 2 && parameters.is_done());
}

void test_a_call_without_end_waits() {
  TestLink link;
  link.step_ms = 1;
  TestNode node(link);
  ros::ServiceClient<Number, Number> client("double");
  node.serviceClient(client);
  connect(link, node);
  link.put_number(100, 4);
  Number number;
  CHECK(client.call(number, number, UINT32_MAX) && number.data == 4);
}

// A board whose host was away for months, and one whose times make no sense.
void test_times_of_long_ago() {
  ros::HostClock clock;
  clock.request(0);
  clock.answer(ros::Time(1000, 0), 0);
  uint32_t now_ms = 0;
  for (int days = 0; days < 60; ++days) {
    for (int minute = 0; minute < 3000; ++minute) clock.advance(now_ms += 28800);
  }
  clock.request(now_ms);
  const ros::Time present = clock.now(now_ms);
  clock.answer(present, now_ms);
  CHECK(clock.drift_ppm() == 0);
  CHECK((clock.now(now_ms) - present).toSec() < 1.0);
  const ros::Time nonsense(UINT32_MAX, UINT32_MAX);
  const ros::Time other(0, 0x80000000u);
  ros::Duration difference = nonsense - other;
  difference += other - nonsense;
  difference -= ros::Duration(INT32_MIN, INT32_MIN);
  clock.request(now_ms);
  clock.answer(nonsense, now_ms);
  CHECK(clock.now(now_ms + 1).nsec < 1000000000u);
}

static_assert(!__is_assignable(ros::Publisher&, const ros::Publisher&), "a node would lose the ones behind it");

}  // namespace

void run_hostile_tests() {
  RUN(test_a_command_that_waited_for_a_loop_that_stood_still_drives_nothing);
  RUN(test_what_has_waited_stays_old_in_the_next_turns);
  RUN(test_a_host_that_leaves_and_another_that_comes_in_one_turn);
  RUN(test_a_host_that_leaves_behind_a_damaged_frame);
  RUN(test_a_loop_that_stood_still_loses_no_frame);
  RUN(test_a_sketch_that_logs_in_each_turn_is_found_by_its_host);
  RUN(test_the_answer_of_a_service_does_not_go_for_messages);
  RUN(test_half_a_service_is_not_announced);
  RUN(test_nothing_is_requested_in_a_callback);
  RUN(test_a_late_answer_is_not_the_next_parameter_s);
  RUN(test_a_parameter_is_waited_for_beside_the_ones_with_defaults);
  RUN(test_the_parameters_behind_one_without_an_answer_are_requested);
  RUN(test_a_call_without_end_waits);
  RUN(test_times_of_long_ago);
  RUN(test_a_link_that_says_it_wrote_more_than_it_was_given);
}
