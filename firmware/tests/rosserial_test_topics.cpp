// Topics: announcements, messages, damage, another connection.
#include <string.h>

#include "rosserial_test.h"

namespace {

int32_t received = 0;
void receive(const Number& number) { received = number.data; }

struct Counter {
  int32_t sum = 0;
  void add(const Number& number) { sum += number.data; }
};

struct SpecialCounter : public Counter {
  int32_t* seen = nullptr;
  void look(const Number& number) const { *seen = number.data; }
  void serve(const Number& request, Number& response) const { response.data = request.data + 1; }
};

void test_topics() {
  TestLink link;
  TestNode node(link);
  Number number;
  ros::Publisher publisher("numbers", &number);
  ros::Subscriber<Number> function("function", &receive);
  Counter counter;
  ros::Subscriber<Number, Counter> member("member", &Counter::add, &counter);
  int32_t captured = 0;
  int32_t calls = 0;
  ros::Subscriber<Number> lambda("lambda", [&captured, &calls](const Number& message) {
    captured = message.data;
    ++calls;
  });
  CHECK(publisher.publish(&number) == 0);  // not advertised
  CHECK(node.advertise(publisher) && node.advertise(publisher));
  CHECK(node.subscribe(function) && node.subscribe(member) && node.subscribe(lambda));
  CHECK(publisher.publish(&number) == 0);  // not connected
  link.request_topics();
  node.spinOnce();
  CHECK(node.connected());
  CHECK(link.sent_id(0) == 10 && link.sent_id(1) == 0 && link.sent_id(2) == 1 && link.sent_id(4) == 1);
  CHECK(link.sent_frames() == 5);
  link.clear();
  link.put_number(100, 7);
  link.put_number(101, 8);
  link.put_number(102, 9);
  node.spinOnce();
  CHECK(received == 7 && counter.sum == 8 && captured == 9 && calls == 1);
  number.data = -2;
  CHECK(publisher.publish(&number) == 4);
  Words words;
  CHECK(publisher.publish(&words) == -1);  // another type
  node.spinOnce();
  CHECK(link.sent_frames() == 1 && link.sent_id(0) == 104);
}

void test_members_of_a_base_class_and_const_ones() {
  TestLink link;
  TestNode node(link);
  SpecialCounter counter;
  int32_t seen = 0;
  counter.seen = &seen;
  const SpecialCounter& fixed = counter;
  ros::Subscriber<Number, SpecialCounter> inherited("a", &SpecialCounter::add, &counter);
  ros::Subscriber<Number, SpecialCounter> constant("b", &SpecialCounter::look, &fixed);
  ros::ServiceServer<Number, Number, SpecialCounter> server("c", &SpecialCounter::serve, &fixed);
  node.subscribe(inherited);
  node.subscribe(constant);
  node.advertiseService(server);
  connect(link, node);
  for (uint16_t id = 100; id < 103; ++id) link.put_number(id, 6);
  node.spinOnce();
  const uint8_t* payload = nullptr;
  size_t size = 0;
  CHECK(counter.sum == 6 && seen == 6);
  CHECK(link.sent(0, payload, size) == 104 && payload[0] == 7);
}

void test_numbers_of_topics_are_bounded() {
  TestLink link;
  TestNode node(link);
  ros::Subscriber<Number> a("a", &receive), b("b", &receive), c("c", &receive), d("d", &receive), e("e", &receive);
  CHECK(node.subscribe(a) && node.subscribe(b) && node.subscribe(c) && node.subscribe(d));
  CHECK(!node.subscribe(e));
  ros::Subscriber<Number> long_name("a_name_that_is_much_longer_than_what_the_buffer_of_this_node_has_room_for",
                                    &receive);
  ros::BufferedNode<4, 3, 64, 128> other(link);
  CHECK(!other.subscribe(long_name));
}

// The announcements of a node whose queue has room for only one of them follow as the line takes them.
void test_announcements_wait_for_room() {
  TestLink link;
  TestNode node(link);
  ros::Subscriber<Number> a("a", &receive), b("b", &receive), c("c", &receive);
  node.subscribe(a);
  node.subscribe(b);
  node.subscribe(c);
  link.request_topics();
  link.room = 20;
  node.spinOnce();
  CHECK(!node.connected());
  for (int turn = 0; turn < 100 && !node.connected(); ++turn) {
    link.room = 10;
    node.spinOnce();
  }
  link.room = kBytes;
  node.spinOnce();
  CHECK(node.connected());
  CHECK(link.sent_frames() == 4 && link.sent_id(1) == 1 && link.sent_id(2) == 1 && link.sent_id(3) == 1);
}

// rosserial_python asks again for each message that it does not know.
void test_topics_may_be_asked_for_again() {
  TestLink link;
  TestNode node(link);
  ros::Subscriber<Number> a("a", &receive);
  node.subscribe(a);
  for (int times = 0; times < 50; ++times) link.request_topics();
  for (int turn = 0; turn < 200; ++turn) {
    node.spinOnce();
    CHECK(node.connected());
  }
  CHECK(link.sent_frames() == 100);
  link.put_number(100, 11);
  node.spinOnce();
  CHECK(received == 11);
}

void test_lost_sync_and_the_old_protocol() {
  TestLink link;
  TestNode node(link);
  ros::Subscriber<Number> a("a", &receive);
  node.subscribe(a);
  connect(link, node);
  const uint8_t version_1[] = {0xFF, 0xFF, 0x04, 0x00, 0x64, 0x00, 1, 2, 3, 4, 0x90};
  const uint8_t half[] = {0xFF, 0xFE, 0x04, 0x00, 0xFB, 0x64, 0x00, 1};
  const uint8_t stray[] = {0xFF};
  link.put(version_1, sizeof version_1);
  link.put(half, sizeof half);
  link.put_number(100, 21);
  node.spinOnce();
  CHECK(received == 21);
  link.put(stray, sizeof stray);
  link.put_number(100, 22);
  node.spinOnce();
  CHECK(received == 22);
  uint8_t large[65] = {};
  link.put_frame(100, large, sizeof large);  // larger than the buffer
  link.put_frame(999, large, 4);             // an unknown id
  link.put_number(100, 23);
  node.spinOnce();
  CHECK(received == 23);
  const uint8_t wrong_version[] = {0xFF, 0xFF, 0x00};
  TestNode original(link, ros::Retry::kNone);
  original.subscribe(a);
  link.clear();
  link.put(wrong_version, sizeof wrong_version);
  original.spinOnce();
  CHECK(link.sent_id(0) == 10);  // shows its version
}

void test_a_message_that_lies_is_refused() {
  TestLink link;
  TestNode node(link);
  size_t values = 0;
  char text[8] = "";
  ros::Subscriber<Words, void, 12> words("words", [&values, &text](const Words& message) {
    values = message.values_length;
    strncpy(text, message.text, sizeof text - 1);
  });
  node.subscribe(words);
  connect(link, node);
  uint8_t payload[64];
  float numbers[4] = {1.0f, 2.0f, 3.0f, 4.0f};
  Words message;
  message.text = "three";
  message.values = numbers;
  message.values_length = 3;
  ros::Writer three(payload, sizeof payload);
  message.serialize(three);
  link.put_frame(100, payload, three.size());
  node.spinOnce();
  CHECK(values == 3 && strcmp(text, "three") == 0);
  CHECK(node.delivered() == 1 && node.refused() == 0);
  link.put_frame(100, payload, three.size() - 1);  // cut
  payload[0] = 200;                                // a text that is longer than the message
  link.put_frame(100, payload, three.size());
  message.values_length = 4;  // more than fits
  ros::Writer four(payload, sizeof payload);
  message.serialize(four);
  link.put_frame(100, payload, four.size());
  ros::Writer more(payload, sizeof payload);  // bytes after the message
  message.values_length = 1;
  message.serialize(more);
  link.put_frame(100, payload, more.size() + 1);
  node.spinOnce();
  CHECK(node.delivered() == 1 && node.refused() == 4);
}

void test_a_large_message_is_refused_and_nothing_goes_for_it() {
  TestLink link;
  TestNode node(link);
  Number number;
  Words words;
  float values[100] = {};
  words.values = values;
  ros::Publisher small("small", &number);
  ros::Publisher large("large", &words);
  node.advertise(small);
  node.advertise(large);
  connect(link, node);
  link.room = 0;
  CHECK(small.publish(&number) == 4);
  words.values_length = 100;
  CHECK(large.publish(&words) == -1);
  CHECK(node.dropped_to_host() == 1);
  link.room = kBytes;
  node.spinOnce();
  CHECK(link.sent_frames() == 2 && link.sent_id(1) == 7);  // and a line of the log
  words.values_length = 20;
  CHECK(large.publish(&words) == 88);
}

void test_another_connection() {
  TestLink link;
  TestNode node(link);
  Number number;
  ros::Publisher publisher("numbers", &number);
  ros::Subscriber<Number> subscriber("commands", &receive);
  node.advertise(publisher);
  node.subscribe(subscriber);
  connect(link, node);
  link.room = 0;
  publisher.publish(&number);
  const uint8_t half[] = {0xFF, 0xFE, 0x04, 0x00, 0xFB, 0x64, 0x00, 1};
  link.put(half, sizeof half);
  node.spinOnce();
  link.room = kBytes;
  link.is_restarted = true;
  node.spinOnce();
  CHECK(!node.connected() && link.to_host_size == 0);
  connect(link, node);
  link.put_number(100, 31);
  node.spinOnce();
  CHECK(received == 31);
}

void test_namespace() {
  TestLink link;
  TestNode node(link);
  node.setNamespace("/robot_7/");
  ros::Subscriber<Number> relative("a", &receive), absolute("/b", &receive);
  node.subscribe(relative);
  node.subscribe(absolute);
  link.request_topics();
  node.spinOnce();
  const uint8_t* payload = nullptr;
  size_t size = 0;
  link.sent(1, payload, size);
  CHECK(payload[2] == 10 && memcmp(payload + 6, "/robot_7/a", 10) == 0);
  link.sent(2, payload, size);
  CHECK(payload[2] == 2 && memcmp(payload + 6, "/b", 2) == 0);
}

}  // namespace

void run_topics_tests() {
  RUN(test_topics);
  RUN(test_members_of_a_base_class_and_const_ones);
  RUN(test_numbers_of_topics_are_bounded);
  RUN(test_announcements_wait_for_room);
  RUN(test_topics_may_be_asked_for_again);
  RUN(test_lost_sync_and_the_old_protocol);
  RUN(test_a_message_that_lies_is_refused);
  RUN(test_a_large_message_is_refused_and_nothing_goes_for_it);
  RUN(test_another_connection);
  RUN(test_namespace);
}
