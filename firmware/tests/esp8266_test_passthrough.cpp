// The passthrough between two ports, and its key.
#include <string>

#include "esp8266_test.h"
#include "src/status_led.h"

namespace {

uint32_t four() { return 4; }

// A passthrough between ports in memory, with a clock that only a test moves.
struct Rig {
  test::MemoryUart uart;
  test::MemoryNetwork network;
  Passthrough passthrough{uart, network, 1};
  uint32_t now_ms = 0xfffff000u;

  size_t device_room = 128;

  explicit Rig(const char* key = "") { passthrough.set_key(key, four); }

  void turn(uint32_t after_ms = 1) {
    now_ms += after_ms;
    uart.room = device_room;
    passthrough.step(now_ms);
    if (passthrough.wants_connection(now_ms)) passthrough.connection_tried(network.connect(), now_ms);
  }
  void turns(int count) {
    for (int i = 0; i < count; ++i) turn();
  }
  void link() {
    while (passthrough.state() != LinkState::kConnected) turn();
  }
  uint32_t ends(LinkEnd end) const { return passthrough.counters().ends[static_cast<size_t>(end)]; }
};

void it_connects_when_the_wifi_is_up() {
  Rig rig;
  rig.network.joined = false;
  rig.turns(100);
  CHECK(rig.passthrough.state() == LinkState::kJoining && !rig.network.connected);
  rig.network.joined = true;
  rig.turns(2);
  CHECK(rig.passthrough.state() == LinkState::kConnected);
}

void it_requests_a_new_join_after_20_s() {
  Rig rig;
  rig.network.joined = false;
  rig.turn(19999);
  CHECK(rig.network.rejoins == 0);
  for (int i = 0; i < 3; ++i) rig.turn(20000);
  CHECK(rig.network.rejoins >= 2);
}

void frames_pass_both_ways_each_in_one_write() {
  Rig rig;
  rig.link();
  rig.uart.from_device = part(kPose, 0, 20);
  rig.turn();
  CHECK(rig.network.writes.empty());
  rig.uart.from_device = part(kPose, 20, 32);
  rig.network.from_host = kTwist;
  rig.turn();
  CHECK(rig.network.writes == std::vector<Bytes>{kPose});
  CHECK(rig.uart.to_device == kTwist);
}

void half_a_command_never_reaches_the_device() {
  Rig rig;
  rig.link();
  rig.network.from_host = kPose + part(kTwist, 0, 30);
  rig.turns(2);
  rig.network.joined = rig.network.connected = false;
  rig.turns(3000);
  CHECK(rig.passthrough.state() == LinkState::kJoining);
  CHECK(rig.uart.to_device == kPose);
  CHECK(rig.passthrough.counters().to_device_discarded_bytes == 30);
}

void a_new_link_begins_with_nothing_of_the_old_one_but_a_started_frame() {
  Rig rig;
  rig.link();
  rig.network.from_host = kPose + kTwist;
  rig.device_room = 10;
  rig.turn();
  rig.device_room = 0;
  rig.network.connected = false;
  rig.turns(2);
  rig.link();
  rig.network.from_host = kTwist + kPose;
  rig.device_room = 128;
  rig.turns(2);
  CHECK(rig.uart.to_device == kPose + kTwist + kPose);
  CHECK(rig.passthrough.counters().to_device_discarded_bytes == kTwist.size());
}

void what_came_while_the_link_was_down_is_not_sent() {
  Rig rig;
  rig.link();
  rig.network.joined = rig.network.connected = false;
  rig.uart.from_device = kPose;
  rig.turns(10);
  rig.uart.from_device = kPose + part(kTwist, 0, 5);
  rig.network.joined = true;
  rig.link();
  rig.uart.from_device = part(kTwist, 5, 56) + kPose;
  rig.turns(2);
  CHECK(rig.network.writes == std::vector<Bytes>{kPose});
}

void last_words_of_a_host_that_closes_reach_the_device() {
  Rig rig;
  rig.link();
  rig.network.from_host = Bytes(700, 0) + frame(11, {});
  rig.network.connected = false;
  rig.turns(20);
  const Bytes& got = rig.uart.to_device;
  CHECK(got.size() == 708 && part(got, 700, 708) == frame(11, {}));
  CHECK(rig.ends(LinkEnd::kPeerClosed) == 1);
}

void a_network_that_accepts_nothing_ends_the_link_after_2_s() {
  Rig rig;
  rig.link();
  rig.network.room = 10;
  rig.uart.from_device = kPose;
  rig.turns(1990);
  CHECK(rig.network.closes == 0);
  rig.turns(20);
  CHECK(rig.ends(LinkEnd::kWriteStalled) == 1);
}

void partial_writes_lose_nothing() {
  Rig rig;
  rig.link();
  rig.network.write_limit = 5;
  rig.uart.from_device = kPose + kTwist;
  rig.turns(30);
  Bytes all;
  for (const Bytes& bytes : rig.network.writes) all = all + bytes;
  CHECK(all == kPose + kTwist);
}

void a_host_that_answers_no_time_request_ends_the_link() {
  Rig rig;
  rig.link();
  rig.uart.from_device = frame(10, Bytes(8, 0));
  rig.turns(5990);
  CHECK(rig.passthrough.state() == LinkState::kConnected);
  rig.turns(20);
  CHECK(rig.ends(LinkEnd::kHostSilent) == 1);
}

void a_host_that_answers_keeps_the_link() {
  Rig rig;
  rig.link();
  for (int i = 0; i < 10; ++i) {
    rig.uart.from_device = frame(10, Bytes(8, 0));
    rig.turns(2500);
    rig.network.from_host = frame(10, Bytes(8, 1));
    rig.turn();
  }
  rig.turns(20000);
  CHECK(rig.network.closes == 0);
}

void a_stalled_network_drops_whole_old_frames() {
  Rig rig;
  rig.link();
  rig.network.room = 0;
  uint8_t number = 0;
  for (int i = 0; i < 100; ++i) {
    rig.uart.from_device = frame(125, Bytes(24, number++));
    rig.turn();
  }
  rig.network.room = 2920;
  rig.turn();
  CHECK(rig.passthrough.counters().from_device_dropped_bytes == 100 * 32 - 64 * 32);
  CHECK(rig.network.writes.size() == 1 && part(rig.network.writes[0], 0, 32) == frame(125, Bytes(24, 36)));
}

std::string hex(const uint8_t* bytes, size_t count) {
  std::string text;
  char pair[3];
  for (size_t i = 0; i < count; ++i) {
    std::snprintf(pair, sizeof pair, "%02x", bytes[i]);
    text += pair;
  }
  return text;
}

std::string hmac_of(const std::string& key, const std::string& text) {
  uint8_t digest[hostlink::Sha256::kDigestBytes];
  hostlink::HmacSha256 hmac(reinterpret_cast<const uint8_t*>(key.data()), key.size());
  hmac.add(reinterpret_cast<const uint8_t*>(text.data()), text.size());
  hmac.finish(digest);
  return hex(digest, sizeof digest);
}

void the_hmac_is_that_of_rfc_4231() {
  CHECK(hmac_of("Jefe", "what do ya want for nothing?") ==
        "5bdcc146bf60754e6a042426089575c75a003f089d2739839dec58b964ec3843");
  CHECK(hmac_of(std::string(131, '\xaa'), "Test Using Larger Than Block-Size Key - Hash Key First") ==
        "60e431591ee0b67f0d8a26aacbf5b77f8e0bc6213728c5140546040f0ee37f54");
}

void with_a_key_nothing_passes_before_the_host_has_proven_it() {
  Rig rig("a key of 16 bytes");
  rig.turns(3);
  CHECK(rig.passthrough.state() == LinkState::kProving && rig.network.writes.empty());
  const Bytes question = {'H', 'L', 'K', '1', 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  rig.network.from_host = question + kTwist;
  rig.uart.from_device = kPose;
  rig.turns(3);
  CHECK(rig.network.writes.size() == 1 && rig.network.writes[0].size() == hostlink::KeyProof::kAnswerBytes);
  CHECK(rig.uart.to_device.empty());  // a command in place of the proof
  CHECK(rig.ends(LinkEnd::kKeyRefused) == 1 && !rig.network.connected);
}

void a_host_that_requires_no_key_is_refused() {
  Rig rig("a key of 16 bytes");
  rig.turns(2);
  rig.network.from_host = kTwist;
  rig.turns(2);
  CHECK(rig.ends(LinkEnd::kKeyRefused) == 1 && rig.uart.to_device.empty());
}

void a_host_that_sends_nothing_is_given_up() {
  Rig rig("a key of 16 bytes");
  rig.turns(2);
  rig.turn(Passthrough::kProof_ms - 10);
  CHECK(rig.passthrough.state() == LinkState::kProving);
  rig.turn(20);
  CHECK(rig.ends(LinkEnd::kKeyRefused) == 1);
}

void the_led_shows_the_state() {
  CHECK(hostlink::is_led_lit(LinkState::kConnected, 123));
  CHECK(hostlink::is_led_lit(LinkState::kJoining, 0) && !hostlink::is_led_lit(LinkState::kJoining, 100));
  CHECK(hostlink::is_led_lit(LinkState::kWaiting, 400) && !hostlink::is_led_lit(LinkState::kWaiting, 500));
}

}  // namespace

void run_passthrough_tests() {
  RUN(it_connects_when_the_wifi_is_up);
  RUN(it_requests_a_new_join_after_20_s);
  RUN(frames_pass_both_ways_each_in_one_write);
  RUN(half_a_command_never_reaches_the_device);
  RUN(a_new_link_begins_with_nothing_of_the_old_one_but_a_started_frame);
  RUN(what_came_while_the_link_was_down_is_not_sent);
  RUN(last_words_of_a_host_that_closes_reach_the_device);
  RUN(a_network_that_accepts_nothing_ends_the_link_after_2_s);
  RUN(partial_writes_lose_nothing);
  RUN(a_host_that_answers_no_time_request_ends_the_link);
  RUN(a_host_that_answers_keeps_the_link);
  RUN(a_stalled_network_drops_whole_old_frames);
  RUN(the_hmac_is_that_of_rfc_4231);
  RUN(with_a_key_nothing_passes_before_the_host_has_proven_it);
  RUN(a_host_that_requires_no_key_is_refused);
  RUN(a_host_that_sends_nothing_is_given_up);
  RUN(the_led_shows_the_state);
}
