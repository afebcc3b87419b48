// libFuzzer: any bytes, in pieces, at any times, into the library's node with topics, services and parameters;
// afterwards a good frame is found, and the watchdog has stopped the motors.
#include <hostlink/command_watchdog.h>
#include <ros/node_handle.h>
#include <ros/parameter.h>
#include <stdlib.h>

#include "rosserial_messages.h"

namespace {

struct FuzzLink : public ros::Link {
  uint32_t now_ms = 0;
  const uint8_t* at = nullptr;
  size_t left = 0;
  bool is_restarted = false;
  uint32_t writes = 0;

  int read() override {
    if (is_restarted) {
      is_restarted = false;
      return kRestarted;
    }
    if (left == 0) return kNothing;
    --left;
    return *at++;
  }
  size_t write(const uint8_t*, size_t size) override {
    ++writes;
    if (writes % 7 == 0) return writes % 2 == 0 ? 0 : SIZE_MAX;  // nothing, or the -1 of an error
    return size / 2 + 1 < size ? size / 2 + 1 : size;
  }
  uint32_t milliseconds() override { return ++now_ms; }
};

uint32_t touched = 0;  // every byte of a message is read: the sanitizer sees where it lies

void read_words(const test_msgs::Words& words) {
  for (const char* c = words.text; *c != '\0'; ++c) touched += static_cast<uint8_t>(*c);
  for (uint32_t i = 0; i < words.values_length; ++i) touched += words.values[i] > 0.0f ? 1u : 0u;
}

void answer(const test_msgs::Words& request, test_msgs::Words& response) {
  read_words(request);
  response = request;  // its text and its values are still there
}

void feed(FuzzLink& link, ros::NodeApi& node, const uint8_t* bytes, size_t size) {
  link.at = bytes;
  link.left = size;
  while (link.left > 0 || link.is_restarted) node.spinOnce();
}

// A payload in a frame with valid checksums: without them no payload reaches the messages.
void feed_frame(FuzzLink& link, ros::NodeApi& node, const uint8_t* payload, size_t size) {
  static const uint8_t kIds[] = {0, 6, 10, 11, 100, 101, 102, 103, 6, 10, 100, 102};
  uint8_t frame[72] = {0xFF, 0xFE, static_cast<uint8_t>(size - 1), 0, static_cast<uint8_t>(~(size - 1))};
  frame[5] = kIds[payload[0] % sizeof kIds];
  memcpy(frame + 7, payload + 1, size - 1);
  uint8_t sum = 0;
  for (size_t i = 5; i < size + 6; ++i) sum = static_cast<uint8_t>(sum + frame[i]);
  frame[size + 6] = static_cast<uint8_t>(~sum);
  feed(link, node, frame, size + 7);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  FuzzLink link;
  ros::BufferedNode<4, 4, 96, 96, 256> node(link);
  bool rolls = false;
  test_msgs::Number number;
  ros::Publisher publisher("numbers", &number);
  ros::Subscriber<test_msgs::Words> words("words", &read_words);
  hostlink::CommandWatchdog watchdog([&rolls]() { rolls = false; });
  ros::Subscriber<test_msgs::Number> command("command", [&](const test_msgs::Number&) { rolls = watchdog.feed(); });
  ros::ServiceServer<test_msgs::Words, test_msgs::Words> server("echo", &answer);
  ros::ServiceClient<test_msgs::Number, test_msgs::Words, 32> client("words");
  ros::Parameter<float, 3> gains("gains", 1.0f);
  ros::TextParameter<16> text("text", "none");
  ros::Parameters parameters;
  parameters.add(gains);
  parameters.add(text);
  node.advertise(publisher);
  node.subscribe(words);
  node.subscribe(command);
  node.advertiseService(server);
  node.serviceClient(client);
  node.attach(watchdog);
  node.attach(parameters);
  while (size > 1) {  // each piece: how long to wait, how many bytes, and whether they are a frame
    link.now_ms += data[0] * 4u;
    link.is_restarted = data[0] == 255;
    const size_t wanted = 1 + data[1] % 64;
    const bool is_frame = data[1] >= 128;
    data += 2;
    size -= 2;
    const size_t piece = wanted < size ? wanted : size;
    if (is_frame && piece > 0) {
      feed_frame(link, node, data, piece);
    } else {
      feed(link, node, data, piece);
    }
    number.data = static_cast<int32_t>(node.now().nsec);
    publisher.publish(&number);
    if (wanted % 2 == 0) {
      client.begin(number, [](const test_msgs::Words* response) {
        if (response != nullptr) read_words(*response);
      });
    }
    data += piece;
    size -= piece;
    if (wanted % 16 == 1 || wanted % 16 == 3) {  // both wait, and the rest of the bytes arrives meanwhile
      link.at = data;
      link.left = size;
      test_msgs::Words response;
      int value = 0;
      if (wanted % 16 == 1 && client.call(number, response, 30)) read_words(response);
      if (wanted % 16 == 3 && node.getParam("value", &value, 1, 30)) touched += static_cast<uint32_t>(value);
      data = link.at;
      size = link.left;
    }
    for (uint8_t line = 0; wanted == 60 && line < 20; ++line) node.loginfo("a line of the log");
  }
  for (int turn = 0; turn < 12; ++turn) {  // silence
    link.now_ms += 300;
    node.spinOnce();
  }
  if (rolls) abort();
  const uint8_t topics_request[] = {0xFF, 0xFE, 0, 0, 0xFF, 0, 0, 0xFF};
  feed(link, node, topics_request, sizeof topics_request);
  for (int turn = 0; turn < 100; ++turn) node.spinOnce();
  if (!node.connected()) abort();
  const uint32_t delivered = node.delivered();
  const uint8_t one[] = {0xFF, 0xFE, 4, 0, 0xFB, 101, 0, 1, 0, 0, 0, 0x99};
  feed(link, node, one, sizeof one);
  if (node.delivered() != delivered + 1 || !rolls) abort();
  return 0;
}
