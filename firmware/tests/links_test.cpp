// The links of Arduino cores on networks that are broken or hostile: TCP whose host vanishes in every way and whose
// WiFi flaps, UDP next to a flood of other datagrams. Client and datagrams are scripted; time is virtual.
#include <hostlink/client_hardware.h>
#include <hostlink/command_watchdog.h>
#include <hostlink/keyed.h>
#include <hostlink/udp_hardware.h>
#include <ros/node_handle.h>

#include <initializer_list>

#include "check.h"
#include "rosserial_messages.h"

namespace {

unsigned long now_ms = 0xFFFFF000ul;  // wraps within four seconds
unsigned long micros_of_board = 0;
unsigned long connect_ms = 0;  // duration of a connect()
unsigned long yield_ms = 0;    // time that passes with each look at the clock
bool is_up = true;
bool is_listening = true;

const uint8_t kTopicsRequest[] = {0xFF, 0xFE, 0, 0, 0xFF, 0, 0, 0xFF};
const uint8_t kDrive[] = {0xFF, 0xFE, 4, 0, 0xFB, 100, 0, 5, 0, 0, 0, 0x96};

// A TCP client: what the host has sent, and how the connection behaves.
struct TestClient {
  uint8_t bytes[4096];
  size_t at = 0;
  size_t size = 0;
  size_t written = 0;
  uint32_t connects = 0;
  bool is_open = false;
  bool has_errors = false;  // write() says -1
  int room = 1000;

  int connect(IPAddress, uint16_t) {
    now_ms += connect_ms;
    ++connects;
    at = size = 0;
    is_open = is_listening;
    return is_open ? 1 : -1;
  }
  int connect(const char*, uint16_t port) { return connect(IPAddress(), port); }
  uint8_t connected() { return is_open ? 1 : 0; }
  int available() { return static_cast<int>(size - at); }
  int read() { return at < size ? bytes[at++] : -1; }
  int availableForWrite() { return room; }
  size_t write(const uint8_t*, size_t count) {
    CHECK(is_open && count <= static_cast<size_t>(room));
    written += count;
    return has_errors ? SIZE_MAX : count;
  }
  void stop() {
    is_open = false;
    at = size = 0;
  }
  void put(const uint8_t* sent, size_t count) {
    memcpy(bytes + size, sent, count);
    size += count;
  }
};

typedef hostlink::ClientHardware<TestClient> Tcp;
typedef test_msgs::Number Number;

// A robot on a link of that kind.
template <class Hardware>
struct TestRobot {
  ros::NodeHandle_<Hardware, 4, 4, 64, 128> node;
  int32_t speed = 0;
  unsigned long stopped_at_ms = 0;
  hostlink::CommandWatchdog watchdog{[this]() {
    speed = 0;
    stopped_at_ms = now_ms;
  }};
  ros::Subscriber<Number> command{"command", [this](const Number& number) {
                                    if (watchdog.feed()) speed = number.data;
                                  }};
  ros::ServiceClient<Number, Number> service{"double"};

  TestRobot() {
    node.attach(watchdog);
    node.subscribe(command);
    node.serviceClient(service);
    node.getHardware()->setNetwork([] { return is_up; });
    node.initNode();
  }
  void turn(unsigned long ms) {
    for (; ms > 0; --ms, ++now_ms) node.spinOnce();
  }
};

struct TcpRobot : public TestRobot<Tcp> {
  TestClient& client() { return node.getHardware()->client(); }
  void drive() {
    turn(3000);
    if (!client().is_open) turn(3000);
    client().put(kTopicsRequest, sizeof kTopicsRequest);
    turn(5);
    client().put(kDrive, sizeof kDrive);
    turn(1);
    CHECK(speed == 5 && node.connected());
  }
};

void reset() {
  is_up = is_listening = true;
  connect_ms = 0;
}

// A host that vanishes in any way: zero velocity, at once if the network reports it, otherwise half a second after the
void test_motors_stop_in_every_way_in_which_a_host_vanishes() {
  reset();
  TcpRobot robot;
  robot.drive();
  robot.client().is_open = false;  // closed by the host
  robot.turn(1);
  CHECK(robot.speed == 0);
  robot.drive();
  connect_ms = 1000;  // and connecting lasts
  is_listening = false;
  robot.client().is_open = false;
  robot.turn(1);
  CHECK(robot.speed == 0);
  reset();
  robot.drive();
  is_up = false;  // the WiFi is lost, and TCP does not notice
  const unsigned long fed_at_ms = now_ms;
  robot.turn(600);
  CHECK(robot.speed == 0 && robot.stopped_at_ms - fed_at_ms <= 502);
  CHECK(robot.client().is_open);
  robot.turn(15000);  // silence: half open
  CHECK(!robot.node.connected() && !robot.client().is_open);
  reset();
  robot.drive();
  robot.client().room = 0;  // the host reads nothing
  robot.turn(600);
  CHECK(robot.speed == 0);
  robot.client().room = 1000;
}

// The sketch waits for a service meanwhile.
void test_motors_stop_while_a_call_waits_for_a_host_that_is_gone() {
  reset();
  TcpRobot robot;
  for (bool is_closed : {false, true}) {
    robot.turn(6000);  // what may still arrive of the last call
    robot.drive();
    const unsigned long began_ms = now_ms;
    if (is_closed) robot.client().is_open = false;
    Number number;
    robot.node.getHardware()->client().room = 1000;
    yield_ms = 1;
    CHECK(!robot.service.call(number, number, 2000));
    yield_ms = 0;
    CHECK(robot.speed == 0 && robot.stopped_at_ms - began_ms <= 502);
  }
}

void test_wifi_that_flaps() {
  reset();
  TcpRobot robot;
  uint32_t random = 7;
  for (int event = 0; event < 2000; ++event) {
    random = random * 1664525u + 1013904223u;
    const uint32_t kind = random >> 29;
    if (kind == 0) is_up = !is_up;
    if (kind == 1) is_listening = !is_listening;
    if (kind == 2) robot.client().is_open = false;
    if (kind == 3) robot.client().room = static_cast<int>(random >> 8 & 7) - 1;
    if (kind > 3 && robot.client().is_open && robot.client().size < 4000) {
      if (robot.client().available() == 0) robot.client().at = robot.client().size = 0;
      robot.client().put(kind == 4 ? kTopicsRequest : kDrive, kind == 4 ? sizeof kTopicsRequest : sizeof kDrive);
    }
    connect_ms = kind == 5 ? 1000 : 0;
    robot.turn(random >> 16 & 127);
    CHECK(robot.speed == 0 || robot.client().is_open);
  }
  reset();
  robot.client().room = 1000;
  robot.turn(16000);
  robot.drive();
}

// One firmware on many boards: they reconnect at different moments.
void test_boards_of_a_fleet_do_not_come_back_in_step() {
  reset();
  is_listening = false;
  unsigned long first_ms[2] = {};
  for (unsigned long board = 0; board < 2; ++board) {
    micros_of_board = 1000 * board + 17;
    Tcp hardware;
    const unsigned long began_ms = now_ms;
    while (hardware.client().connects < 5) {
      hardware.read();
      ++now_ms;
    }
    first_ms[board] = now_ms - began_ms;
  }
  CHECK(first_ms[0] != first_ms[1]);
  micros_of_board = 0;
}

// Datagrams of the host and of others, in order.
struct TestUdp {
  static bool is_like_esp32;  // whose parsePacket() finds nothing until everything is read
  static uint32_t foreign;    // how many datagrams of others arrive before the host's next one
  static IPAddress host;
  static uint16_t port;
  static uint8_t bytes[64];
  static size_t size;
  static uint32_t written;

  int left = 0;
  bool is_foreign = false;
  size_t at = 0;

  uint8_t begin(uint16_t) { return 1; }
  int parsePacket() {
    if (is_like_esp32 && left > 0) return 0;
    is_foreign = foreign > 0;
    if (is_foreign) --foreign;
    left = is_foreign ? 1400 : static_cast<int>(size);
    at = 0;
    if (!is_foreign) size = 0;
    return left;
  }
  int available() { return left; }
  int read() {
    if (left == 0) return -1;
    --left;
    return is_foreign ? 0xFF : bytes[at++];
  }
  int read(uint8_t* to, size_t count) {
    size_t i = 0;
    for (; i < count && left > 0; ++i) to[i] = static_cast<uint8_t>(read());
    return static_cast<int>(i);
  }
  IPAddress remoteIP() { return is_foreign ? IPAddress(6, 6, 6, 6) : host; }
  uint16_t remotePort() { return port; }
  int beginPacket(IPAddress, uint16_t) { return 1; }
  size_t write(const uint8_t*, size_t count) {
    written += 1;
    return count;
  }
  int endPacket() { return 1; }
  static void put(const uint8_t* sent, size_t count) {
    memcpy(bytes, sent, count);
    size = count;
  }
};
bool TestUdp::is_like_esp32 = false;
uint32_t TestUdp::foreign = 0;
IPAddress TestUdp::host;
uint16_t TestUdp::port = 0;
uint8_t TestUdp::bytes[64];
size_t TestUdp::size = 0;
uint32_t TestUdp::written = 0;

const IPAddress kUdpHost(10, 0, 0, 1);

struct UdpRobot : public TestRobot<hostlink::UdpHardware<TestUdp>> {
  explicit UdpRobot(bool is_like_esp32) {
    reset();
    TestUdp::is_like_esp32 = is_like_esp32;
    TestUdp::host = kUdpHost;
    TestUdp::port = 11411;
    node.getHardware()->setConnection(kUdpHost);
  }
  void drive() {
    TestUdp::put(kTopicsRequest, sizeof kTopicsRequest);
    turn(5);
    CHECK(node.connected());
    TestUdp::put(kDrive, sizeof kDrive);
    turn(10);
    CHECK(speed == 5);
  }
};

void test_datagrams_of_others_do_not_delay_the_host_s() {
  for (bool is_like_esp32 : {false, true}) {
    UdpRobot robot(is_like_esp32);
    robot.drive();
    robot.speed = 0;
    TestUdp::foreign = 100;
    TestUdp::put(kDrive, sizeof kDrive);
    robot.turn(10);
    CHECK(robot.speed == 5);
    TestUdp::foreign = 1000000;  // a flood without end, and the host is not heard
    robot.turn(600);
    CHECK(robot.speed == 0);
    TestUdp::foreign = 0;
  }
}

// A second daemon of the host's computer, say.
void test_another_port_of_the_host_is_nobody() {
  for (bool is_like_esp32 : {false, true}) {
    UdpRobot robot(is_like_esp32);
    TestUdp::port = 11412;
    TestUdp::put(kTopicsRequest, sizeof kTopicsRequest);
    robot.turn(5);
    CHECK(!robot.node.connected());
    TestUdp::port = 11411;
    robot.drive();
  }
}

// Its last messages were for the old host; setting the same address again changes nothing.
void test_a_board_that_is_given_another_host_stops_and_begins_anew() {
  const IPAddress other(10, 0, 0, 2);
  for (bool is_like_esp32 : {false, true}) {
    UdpRobot robot(is_like_esp32);
    robot.drive();
    robot.node.getHardware()->setConnection(kUdpHost);
    robot.turn(1);
    CHECK(robot.speed == 5 && robot.node.connected());
    uint8_t both[sizeof kTopicsRequest + sizeof kDrive];  // the request ends the turn
    memcpy(both, kTopicsRequest, sizeof kTopicsRequest);
    memcpy(both + sizeof kTopicsRequest, kDrive, sizeof kDrive);
    TestUdp::put(both, sizeof both);
    robot.turn(1);
    robot.node.getHardware()->setConnection(other);
    robot.turn(1);
    CHECK(robot.speed == 0 && !robot.node.connected());
    TestUdp::written = 0;
    robot.turn(1000);
    CHECK(robot.speed == 0 && TestUdp::written > 0);  // it greets
    TestUdp::put(kTopicsRequest, sizeof kTopicsRequest);
    robot.turn(5);
    CHECK(!robot.node.connected());
    TestUdp::host = other;
    robot.drive();
  }
}

// A client without the key: any bytes, in any pieces, before the proof.
void test_a_host_without_the_key_gets_no_byte_and_drives_nothing() {
  reset();
  TestRobot<hostlink::Keyed<Tcp>> robot;
  robot.node.getHardware()->setKey("0123456789abcdef0123456789abcdef", [] { return static_cast<uint32_t>(4); });
  TestClient& client = robot.node.getHardware()->client();
  uint32_t random = 3;
  for (int event = 0; event < 300; ++event) {
    client.written = 0;
    client.has_errors = event % 2 == 1;
    if (!client.is_open) robot.turn(2000);
    uint8_t question[20] = {'H', 'L', 'K', '1'};
    random = random * 1664525u + 1013904223u;
    if (random >> 31 != 0) client.put(question, sizeof question);
    for (int piece = 0; piece < 20 && client.is_open; ++piece) {
      client.put(piece % 2 == 0 ? kTopicsRequest : kDrive, piece % 2 == 0 ? sizeof kTopicsRequest : sizeof kDrive);
      robot.turn(1);
    }
    CHECK(client.written % 52 == 0 && (client.has_errors || client.written <= 52));  // its own question and answer
    CHECK(robot.speed == 0 && !robot.node.connected());
  }
}

}  // namespace

unsigned long millis() { return static_cast<uint32_t>(now_ms); }
unsigned long micros() { return now_ms * 1000 + micros_of_board; }
void yield() { now_ms += yield_ms; }

int main() {
  RUN(test_motors_stop_in_every_way_in_which_a_host_vanishes);
  RUN(test_motors_stop_while_a_call_waits_for_a_host_that_is_gone);
  RUN(test_wifi_that_flaps);
  RUN(test_boards_of_a_fleet_do_not_come_back_in_step);
  RUN(test_datagrams_of_others_do_not_delay_the_host_s);
  RUN(test_another_port_of_the_host_is_nobody);
  RUN(test_a_board_that_is_given_another_host_stops_and_begins_anew);
  RUN(test_a_host_without_the_key_gets_no_byte_and_drives_nothing);
  return test::report();
}
