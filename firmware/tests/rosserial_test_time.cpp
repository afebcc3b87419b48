// The host's time, its silence, the watchdog, the log, and a hardware of ros_lib.
#include <hostlink/command_watchdog.h>
#include <hostlink/updates.h>
#include <string.h>

#include "rosserial_test.h"

namespace {

void test_time() {
  TestLink link;
  TestNode node(link);
  CHECK(node.now().isZero());
  connect(link, node);
  link.now_ms += 20;  // the round trip
  link.put_time(1000, 500000000u);
  node.spinOnce();
  const ros::Time first = node.now();
  CHECK(first.sec == 1000 && first.nsec == 510000000u);
  CHECK(node.clock().round_trip_ms() == 20);
  // The board's clock is 1 % too slow: 990 of its milliseconds are a second.
  uint32_t host_ms = 1000510u;
  for (int second = 0; second < 100; ++second) {
    link.now_ms += 990;
    host_ms += 1000;
    node.clock().request(link.now_ms);
    link.put_time(host_ms / 1000, host_ms % 1000 * 1000000u);
    node.spinOnce();
  }
  CHECK(node.clock().drift_ppm() > 9500 && node.clock().drift_ppm() < 10500);
  ros::Time last = node.now();
  for (int ms = 0; ms < 9900; ++ms) {  // ten seconds without an answer
    link.now_ms += 1;
    const ros::Time now = node.now();
    CHECK(!(now < last));
    last = now;
  }
  const double error_s = last.toSec() - static_cast<double>(host_ms + 10000u) * 0.001;
  CHECK(error_s < 0.01 && error_s > -0.01);
  node.clock().request(link.now_ms);
  link.put_time(500, 0);  // the host's clock was set
  node.spinOnce();
  CHECK(node.now().sec == 500);
}

// A WiFi holds up one answer of ten for up to 300 ms, on its way back: half of the round trip would be wrong.
void test_answers_that_are_held_up_do_not_move_the_time() {
  ros::HostClock clock;
  uint32_t now_ms = 0xFFFF0000u;
  uint32_t host_ms = 1000000;
  const auto exchange = [&clock, &now_ms, &host_ms](uint32_t there_ms, uint32_t back_ms) {
    clock.request(now_ms);
    host_ms += there_ms;
    const ros::Time stamp(host_ms / 1000, host_ms % 1000 * 1000000u);
    host_ms += back_ms;
    now_ms += there_ms + back_ms;
    clock.answer(stamp, now_ms);
    now_ms += 2500;
    host_ms += 2500;
    clock.advance(now_ms);
    return (clock.now(now_ms) - ros::Time(host_ms / 1000, host_ms % 1000 * 1000000u)).toSec();
  };
  double worst_s = 0.0;
  for (uint32_t number = 0; number < 200; ++number) {
    const double error_s = exchange(5, number % 10 == 9 ? 100 + number : 5);
    worst_s = error_s > worst_s ? error_s : error_s < -worst_s ? -error_s : worst_s;
  }
  CHECK(worst_s < 0.003);
  for (int number = 0; number < 30; ++number) exchange(200, 200);  // from now on it is so slow
  CHECK(clock.round_trip_ms() == 400);
  host_ms += 5000;  // and its clock is set
  for (int number = 0; number < 3; ++number) exchange(200, 200);
  const double error_s = exchange(200, 200);
  CHECK(error_s < 0.01 && error_s > -0.01);
}

void test_times() {
  CHECK(ros::Time(5, 900000000u) + ros::Duration(0.2) == ros::Time(6, 100000000u) ||
        (ros::Time(5, 900000000u) + ros::Duration(0.2) - ros::Time(6, 100000000u)).toSec() < 1e-6);
  CHECK(ros::Time(5, 100000000u) - ros::Duration(0, 200000000) == ros::Time(4, 900000000u));
  CHECK(ros::Time(5, 0) + ros::Duration(-1, 500000000) == ros::Time(4, 500000000u));
  CHECK((ros::Time(4, 900000000u) - ros::Time(5, 0)).toSec() < -0.0999);
  CHECK(ros::Duration(0, -1) == ros::Duration(-1, 999999999));
}

void test_eleven_seconds_of_silence() {
  TestLink link;
  TestNode node(link);
  connect(link, node);
  link.now_ms += 10900;
  node.spinOnce();
  CHECK(node.connected());
  link.now_ms += 300;
  node.spinOnce();
  CHECK(!node.connected());
}

void test_watchdog() {
  TestLink link;
  TestNode node(link);
  int32_t speed = 0;
  hostlink::CommandWatchdog watchdog([&speed]() { speed = 0; });
  speed = 5;
  CHECK(!watchdog.feed() && speed == 0);  // not attached: nothing would stop it
  node.attach(watchdog);
  CHECK(!watchdog.feed());  // no host
  connect(link, node);
  CHECK(watchdog.feed());
  speed = 5;
  link.now_ms += 500;
  node.spinOnce();
  CHECK(speed == 5);
  link.now_ms += 1;
  node.spinOnce();
  CHECK(speed == 0 && watchdog.stops() == 1 && !watchdog.is_running());
  watchdog.feed();
  speed = 5;
  link.put_frame(11, nullptr, 0);
  node.spinOnce();
  CHECK(speed == 0);
  connect(link, node);
  watchdog.feed();
  speed = 5;
  link.step_ms = 1;
  int value = 0;
  CHECK(!node.getParam("~silent", &value, 1, 700));  // a sketch that waits
  CHECK(speed == 0);
}

// Like the updates over the air of an ESP8266.
class Ota {
 public:
  void setHostname(const char* name) { hostname = name; }
  void setPassword(const char* text) { password = text; }
  template <class F>
  void onStart(F start) {
    start_ = start;
  }
  void begin() { ++begins; }
  void handle() { ++handles; }
  void start() { start_(); }

  const char* hostname = "";
  const char* password = "";
  int begins = 0;
  int handles = 0;

 private:
  ros::Callable<void()> start_;
};

void test_updates_wait_for_a_robot_and_stop_it() {
  TestLink link;
  TestNode node(link);
  int32_t speed = 0;
  hostlink::CommandWatchdog watchdog([&speed]() { speed = 0; });
  node.attach(watchdog);
  connect(link, node);
  Ota ota;
  hostlink::Updates<Ota> none(ota, watchdog);
  none.begin("robot_3", "");
  none.spin();
  CHECK(ota.begins == 0 && ota.handles == 0);  // without a password updates are off
  hostlink::Updates<Ota> updates(ota, watchdog);
  updates.begin("", "secret");
  updates.begin("", "secret");
  CHECK(ota.begins == 1 && strcmp(ota.password, "secret") == 0 && ota.hostname[0] == 0);
  watchdog.feed();
  speed = 5;
  updates.spin();
  CHECK(ota.handles == 0 && speed == 5);  // it is driven
  link.now_ms += 501;
  node.spinOnce();
  updates.spin();
  CHECK(ota.handles == 1 && speed == 0);
  watchdog.feed();
  speed = 5;
  ota.start();
  CHECK(speed == 0 && !watchdog.is_running());
  Ota of_a_sensor;
  hostlink::Updates<Ota> sensor(of_a_sensor);
  sensor.begin("sonar", "secret");
  sensor.spin();
  of_a_sensor.start();
  CHECK(of_a_sensor.handles == 1 && strcmp(of_a_sensor.hostname, "sonar") == 0);
}

void test_logs() {
  TestLink link;
  TestNode node(link);
  char text[300];
  memset(text, 'x', sizeof text - 1);
  text[sizeof text - 1] = '\0';
  node.logwarn(text);
  node.spinOnce();
  const uint8_t* payload = nullptr;
  size_t size = 0;
  CHECK(link.sent(0, payload, size) == 7 && size == 128 && payload[0] == 2 && payload[1] == 123);  // cut
}

// A hardware with ros_lib's interface.
struct OldHardware {
  static uint32_t sent;
  void init() {}
  int read() { return -1; }
  void write(uint8_t*, int size) { sent += static_cast<uint32_t>(size); }
  unsigned long time() { return 0; }
};
uint32_t OldHardware::sent = 0;

void test_hardware_of_ros_lib() {
  static ros::NodeHandle_<OldHardware, 2, 2, 64, 128> node;
  node.initNode();
  node.loginfo("hello");
  node.spinOnce();
  CHECK(OldHardware::sent == 8 + 5 + 5);
}

}  // namespace

void run_time_tests() {
  RUN(test_time);
  RUN(test_answers_that_are_held_up_do_not_move_the_time);
  RUN(test_times);
  RUN(test_eleven_seconds_of_silence);
  RUN(test_watchdog);
  RUN(test_updates_wait_for_a_robot_and_stop_it);
  RUN(test_logs);
  RUN(test_hardware_of_ros_lib);
}
