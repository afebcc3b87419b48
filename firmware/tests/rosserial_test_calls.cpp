// Services and parameters, and callbacks that wait for others.
#include <ros/parameter.h>
#include <string.h>

#include "rosserial_test.h"

namespace {

void answer_double(const Number& request, Number& response) { response.data = 2 * request.data; }

void test_service_server() {
  TestLink link;
  TestNode node(link);
  ros::ServiceServer<Number, Number> server("double", &answer_double);
  CHECK(node.advertiseService(server));
  link.request_topics();
  node.spinOnce();
  CHECK(link.sent_id(1) == 2 && link.sent_id(2) == 3);
  link.clear();
  link.put_number(100, 21);
  node.spinOnce();
  const uint8_t* payload = nullptr;
  size_t size = 0;
  CHECK(link.sent(0, payload, size) == 104 && size == 4 && payload[0] == 42);
}

void answer_triple(Number& request, Number& response) { response.data = 3 * request.data; }

struct Multiplier {
  int32_t factor = 4;
  void answer(Number& request, Number& response) { response.data = factor * request.data; }
  void answer_fixed(Number& request, Number& response) const { response.data = factor * request.data; }
};

void test_service_servers_in_the_spelling_of_ros() {
  TestLink link;
  ros::BufferedNode<4, 4, 64, 128> node(link);
  Multiplier multiplier;
  const Multiplier fixed;
  ros::ServiceServer<Number, Number> function("a", &answer_triple);
  ros::ServiceServer<Number, Number, Multiplier> member("b", &Multiplier::answer, &multiplier);
  ros::ServiceServer<Number, Number, Multiplier> fixed_member("c", &Multiplier::answer_fixed, &fixed);
  ros::ServiceServer<Number, Number> lambda(
      "d", [](Number& request, Number& response) { response.data = 5 * request.data; });
  CHECK(node.advertiseService(function) && node.advertiseService(member));
  CHECK(node.advertiseService(fixed_member) && node.advertiseService(lambda));
  connect(link, node);
  const uint8_t factors[] = {3, 4, 4, 5};
  for (uint16_t number = 0; number < 4; ++number) {
    link.clear();
    link.put_number(static_cast<uint16_t>(100 + number), 7);
    node.spinOnce();
    const uint8_t* payload = nullptr;
    size_t size = 0;
    CHECK(link.sent(0, payload, size) == 104 + number && size == 4 && payload[0] == 7 * factors[number]);
  }
}

void test_service_client() {
  TestLink link;
  TestNode node(link);
  ros::ServiceClient<Number, Number> client("double");
  CHECK(node.serviceClient(client));
  Number request;
  int32_t answer = 0;
  int32_t failed = 0;
  auto on_answer = [&answer, &failed](const Number* response) {
    if (response == nullptr) ++failed;
    if (response != nullptr) answer = response->data;
  };
  CHECK(!client.begin(request, on_answer));  // not connected
  link.request_topics();
  node.spinOnce();
  CHECK(link.sent_id(1) == 4 && link.sent_id(2) == 5);
  CHECK(client.begin(request, on_answer, 200));
  CHECK(!client.begin(request, on_answer, 200));  // one at a time
  link.put_number(100, 5);
  node.spinOnce();
  CHECK(answer == 5 && failed == 0);
  CHECK(client.begin(request, on_answer, 200));
  link.now_ms += 250;
  node.spinOnce();
  CHECK(failed == 1);
  CHECK(!client.begin(request, on_answer, 200));  // its answer may still arrive
  link.put_number(100, 6);
  node.spinOnce();
  CHECK(answer == 5);  // too late: dropped
  CHECK(client.begin(request, on_answer, 200));
  link.put_frame(11, nullptr, 0);  // the host stops
  node.spinOnce();
  CHECK(failed == 2);
}

void test_a_call_that_waits() {
  TestLink link;
  link.step_ms = 1;
  TestNode node(link);
  ros::ServiceClient<Number, Words, 16> client("words");
  node.serviceClient(client);
  connect(link, node);
  uint8_t payload[64];
  Words words;
  words.text = "kept";
  ros::Writer out(payload, sizeof payload);
  words.serialize(out);
  link.put_frame(100, payload, out.size());
  link.request_topics();  // after it: must not overwrite it
  Number request;
  Words response;
  CHECK(client.call(request, response, 100));
  CHECK(strcmp(response.text, "kept") == 0);
  node.spinOnce();
  CHECK(link.sent_id(1) == 10);  // the frame after it was not lost
  const uint32_t began_ms = link.now_ms;
  CHECK(!client.call(request, response, 100));
  CHECK(link.now_ms - began_ms >= 100 && link.now_ms - began_ms < 150);
}

void test_parameters() {
  TestLink link;
  link.step_ms = 1;
  TestNode node(link);
  connect(link, node);
  uint8_t payload[64];
  ros::Writer ints(payload, sizeof payload);
  ints.put(static_cast<uint32_t>(2));
  ints.put(static_cast<int32_t>(-7));
  ints.put(static_cast<int32_t>(8));
  ints.put(static_cast<uint64_t>(0));
  int numbers[2] = {1, 2};
  link.put_frame(6, payload, ints.size());
  CHECK(node.getParam("~numbers", numbers, 2) && numbers[0] == -7 && numbers[1] == 8);
  link.put_frame(6, payload, ints.size());
  int one = 1;
  CHECK(!node.getParam("~numbers", &one) && one == 1);  // two are not one
  float missing = 0.5f;
  const uint8_t none[12] = {};
  link.put_frame(6, none, sizeof none);
  CHECK(!node.getParam("~missing", &missing) && missing == 0.5f);
  const uint32_t began_ms = link.now_ms;
  CHECK(!node.getParam("~silent", &missing, 1, 200));
  CHECK(link.now_ms - began_ms < 250);
  link.now_ms += 1000;  // its answer no longer arrives
  const uint8_t text[] = {0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 5, 0, 0, 0, 'h', 'e', 'l', 'l', 'o'};
  char chars[6] = "";
  link.put_frame(6, text, sizeof text);
  CHECK(node.getParam("~text", chars) && strcmp(chars, "hello") == 0);
  char few[5] = "none";
  link.put_frame(6, text, sizeof text);
  CHECK(!node.getParam("~text", few) && strcmp(few, "none") == 0);
}

void answer_number(TestLink& link, int32_t value) {
  uint8_t answer[16] = {};
  ros::Writer out(answer, sizeof answer);
  out.put(static_cast<uint32_t>(1));
  out.put(value);
  out.put(static_cast<uint64_t>(0));
  link.put_frame(6, answer, out.size());
}

void test_parameters_with_defaults() {
  TestLink link;
  TestNode node(link);
  ros::Parameter<float> radius("radius", 0.05f, 0.01f, 0.5f);
  ros::Parameter<int> count("count", 3);
  ros::Parameters parameters;
  parameters.add(radius);
  parameters.add(count);
  parameters.add(count);
  node.attach(parameters);
  connect(link, node);
  const uint8_t* payload = nullptr;
  size_t size = 0;
  node.spinOnce();
  link.clear();
  uint8_t answer[20] = {};
  ros::Writer radius_answer(answer, sizeof answer);
  radius_answer.put(static_cast<uint32_t>(0));
  radius_answer.put(static_cast<uint32_t>(1));
  radius_answer.put(9.0f);  // out of range
  radius_answer.put(static_cast<uint32_t>(0));
  link.put_frame(6, answer, radius_answer.size());
  node.spinOnce();
  CHECK(radius == 0.05f && !radius.is_from_host());
  CHECK(link.sent_id(0) == 7);  // the refusal
  CHECK(link.sent(1, payload, size) == 6 && size == 9);
  answer_number(link, 5);
  node.spinOnce();
  CHECK(count == 5 && count.is_from_host() && parameters.is_done());
}

// The host is lost and reconnects while the sketch waits: the answer now belongs to the newest request.
void test_a_parameter_that_is_given_up_takes_no_answer_from_another() {
  TestLink link;
  link.step_ms = 1;
  TestNode node(link);
  ros::Parameter<int> count("count", 3);
  ros::Parameters parameters;
  parameters.add(count);
  node.attach(parameters);
  connect(link, node);
  node.spinOnce();
  answer_number(link, 5);
  node.spinOnce();
  CHECK(count == 5 && parameters.is_done());
  link.put_frame(11, nullptr, 0);
  link.request_topics();
  int missing = 1;
  CHECK(!node.getParam("~missing", &missing, 1, 200) && missing == 1);
  CHECK(node.connected() && !parameters.is_done());
  answer_number(link, 6);
  node.spinOnce();
  node.spinOnce();
  CHECK(count == 6 && parameters.is_done());
}

// The number of the first frame with this id that was sent; -1: there is none.
int first_sent(const TestLink& link, int id) {
  for (int number = 0; link.sent_id(static_cast<size_t>(number)) >= 0; ++number) {
    if (link.sent_id(static_cast<size_t>(number)) == id) return number;
  }
  return -1;
}

// On a UART only the request for topics shows that it is another host.
void test_a_host_that_was_killed_and_started_again_is_asked_for_the_parameters() {
  TestLink link;
  TestNode node(link);
  Number number;
  ros::Publisher first("first", &number), second("second", &number);
  node.advertise(first);
  node.advertise(second);
  ros::Parameter<int> count("count", 3);
  ros::Parameters parameters;
  parameters.add(count);
  node.attach(parameters);
  for (int host = 0; host < 300; ++host) {
    link.clear();
    link.from_host_at = link.from_host_size = 0;
    link.request_topics();
    for (int turn = 0; turn < 40; ++turn) {  // of a slow line: the topics do not fit into one turn
      link.room = 20;
      node.spinOnce();
      CHECK(host == 0 || (node.connected() && parameters.is_done()));  // the present value stays
    }
    CHECK(first_sent(link, 6) == 3);  // after the time and both topics
    answer_number(link, host);
    node.spinOnce();
    CHECK(count == host && parameters.is_done());
  }
}

void test_a_host_that_is_killed_while_a_parameter_is_awaited() {
  TestLink link;
  TestNode node(link);
  ros::Parameter<int> first("first", 1), second("second", 2);
  ros::Parameters parameters;
  parameters.add(first);
  parameters.add(second);
  node.attach(parameters);
  connect(link, node);
  answer_number(link, 5);
  node.spinOnce();  // the second is requested
  link.clear();
  link.request_topics();
  node.spinOnce();
  CHECK(first_sent(link, 10) == 0 && first_sent(link, 6) < 0);  // the earlier answer may still arrive
  link.now_ms += 1001;
  node.spinOnce();
  CHECK(first_sent(link, 6) > 0 && !parameters.is_done());
  answer_number(link, 7);
  node.spinOnce();
  CHECK(first == 7 && second == 2 && !parameters.is_done());
  answer_number(link, 8);
  node.spinOnce();
  CHECK(second == 8 && parameters.is_done());
  connect(link, node);
  connect(link, node);
  answer_number(link, 9);  // of the same host, whose request arrived between: dropped
  node.spinOnce();
  CHECK(first == 7 && first_sent(link, 6) == 0);
}

void test_what_a_later_answer_cannot_replace_is_still_the_host_s() {
  TestLink link;
  TestNode node(link);
  ros::Parameter<int> count("count", 3, 0, 10);
  ros::Parameters parameters;
  parameters.add(count);
  node.attach(parameters);
  for (int number = 5; number <= 50; number += 45) {
    connect(link, node);
    node.spinOnce();
    answer_number(link, number);
    node.spinOnce();
    CHECK(count == 5 && count.is_from_host() && parameters.is_done());
  }
}

int nested = 0;
ros::NodeApi* nested_node = nullptr;
void spin_again(const Number&) {
  ++nested;
  nested_node->spinOnce();
  int value = 0;
  CHECK(!nested_node->getParam("~x", &value, 1, 1000000));
}

void test_a_callback_that_spins() {
  TestLink link;
  link.step_ms = 1;
  TestNode node(link);
  nested_node = &node;
  ros::Subscriber<Number> subscriber("a", &spin_again);
  node.subscribe(subscriber);
  connect(link, node);
  link.put_number(100, 1);
  link.put_number(100, 2);
  node.spinOnce();
  CHECK(nested == 2);
}

}  // namespace

void run_calls_tests() {
  RUN(test_service_server);
  RUN(test_service_servers_in_the_spelling_of_ros);
  RUN(test_service_client);
  RUN(test_a_call_that_waits);
  RUN(test_parameters);
  RUN(test_parameters_with_defaults);
  RUN(test_a_parameter_that_is_given_up_takes_no_answer_from_another);
  RUN(test_a_host_that_was_killed_and_started_again_is_asked_for_the_parameters);
  RUN(test_a_host_that_is_killed_while_a_parameter_is_awaited);
  RUN(test_what_a_later_answer_cannot_replace_is_still_the_host_s);
  RUN(test_a_callback_that_spins);
}
