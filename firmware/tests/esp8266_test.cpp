// Unit tests of the passthrough's pure part: tables of bytes and times, no port and no clock.
#include <cstdio>
#include <functional>
#include <string>

#include "esp8266_board.h"
#include "src/backoff.h"
#include "src/passthrough.h"
#include "src/status_led.h"

using hostlink::Backoff;
using hostlink::FrameAssembler;
using hostlink::LinkEnd;
using hostlink::LinkState;
using hostlink::Passthrough;
using test::Bytes;
using test::frame;
using test::operator+;

namespace {
int failures = 0;
const char* running = "";

#define CHECK(condition) check((condition), #condition, __LINE__)
void check(bool is_true, const char* text, int line) {
  if (is_true) return;
  ++failures;
  std::printf("%s, line %d: %s\n", running, line, text);
}

constexpr hostlink::Hold kHold = {20, 500};
constexpr size_t kAll = FrameAssembler::kCapacityBytes;
const Bytes kPose = frame(125, Bytes(24, 7));
const Bytes kTwist = frame(126, Bytes(48, 9));

size_t put(FrameAssembler& a, const Bytes& bytes, uint32_t now_ms) { return a.put(bytes.data(), bytes.size(), now_ms); }

Bytes part(const Bytes& bytes, size_t from, size_t to) {
  return Bytes(bytes.begin() + static_cast<std::ptrdiff_t>(from), bytes.begin() + static_cast<std::ptrdiff_t>(to));
}

void a_frame_leaves_when_it_is_whole() {
  FrameAssembler a(kHold);
  for (size_t i = 0; i + 1 < kPose.size(); ++i) {
    put(a, part(kPose, i, i + 1), 0);
    CHECK(a.ready_bytes(kAll, 0) == 0);
  }
  put(a, part(kPose, kPose.size() - 1, kPose.size()), 0);
  CHECK(a.ready_bytes(kAll, 0) == kPose.size());
}

void whole_frames_leave_together_and_the_rest_waits() {
  FrameAssembler a(kHold);
  put(a, kPose + kTwist + part(kPose, 0, 9), 0);
  CHECK(a.ready_bytes(kAll, 0) == kPose.size() + kTwist.size());
  CHECK(a.ready_bytes(kPose.size() + 1, 0) == kPose.size());  // no frame is cut
  CHECK(a.ready_bytes(kPose.size() - 1, 0) == 0);
}

void half_a_frame_leaves_after_a_quiet_time() {
  FrameAssembler a(kHold);
  put(a, part(kPose, 0, 10), 100);
  CHECK(a.ready_bytes(kAll, 119) == 0);
  CHECK(a.ready_bytes(kAll, 120) == 10);
}

void half_a_frame_leaves_after_the_longest_time_although_bytes_drip() {
  FrameAssembler a(kHold);
  const Bytes longest = frame(125, Bytes(1024, 1));
  uint32_t now_ms = 0;
  for (size_t i = 0; i < 50; ++i, now_ms += 10) {
    put(a, part(longest, i, i + 1), now_ms);
    CHECK(a.ready_bytes(kAll, now_ms) == 0);
  }
  CHECK(now_ms == 500);
  CHECK(a.ready_bytes(kAll, now_ms) == 50);
}

void the_timeout_survives_the_wrap_of_the_clock() {
  FrameAssembler a(kHold);
  put(a, part(kPose, 0, 10), 0xfffffff8u);
  CHECK(a.ready_bytes(kAll, 0xffffffffu) == 0);
  CHECK(a.ready_bytes(kAll, 11) == 0);
  CHECK(a.ready_bytes(kAll, 12) == 10);
}

void noise_leaves_when_a_frame_follows_or_when_it_is_long() {
  FrameAssembler a(kHold);
  put(a, Bytes(5, 'x'), 0);
  CHECK(a.ready_bytes(kAll, 0) == 0);
  put(a, kPose, 0);
  CHECK(a.ready_bytes(kAll, 0) == 5 + kPose.size());
  a.take(5 + kPose.size());
  put(a, Bytes(64, 'x'), 0);
  CHECK(a.ready_bytes(kAll, 0) == 64);
}

void a_bad_checksum_hides_no_frame() {
  FrameAssembler a(kHold);
  Bytes lost_a_byte = kPose;
  lost_a_byte.erase(lost_a_byte.begin() + 12);
  put(a, lost_a_byte + kTwist, 0);
  CHECK(a.has_frame(126, kAll));
  CHECK(!a.has_frame(125, kAll));
  CHECK(a.ready_bytes(kAll, 0) == lost_a_byte.size() + kTwist.size());
}

void a_claim_over_the_limit_is_no_frame() {
  FrameAssembler a(kHold);
  put(a, Bytes{0xff, 0xfe, 0xff, 0x7f, 0x81, 1, 2, 3} + kPose, 0);
  CHECK(a.ready_bytes(kAll, 0) == 8 + kPose.size());
}

void a_cut_frame_goes_on_at_once() {
  FrameAssembler a(kHold);
  put(a, kTwist + part(kPose, 0, 4), 0);
  a.take(10);
  CHECK(a.ready_bytes(20, 0) == 20);
  CHECK(a.ready_bytes(kAll, 0) == kTwist.size() - 10);
  CHECK(a.forget_unstarted() == 4);
  CHECK(a.size_bytes() == kTwist.size() - 10);
}

void a_full_buffer_drops_the_oldest_frame_but_not_the_started_one() {
  FrameAssembler a(kHold);
  while (a.room_bytes() >= kPose.size()) put(a, kPose, 0);
  a.take(8);
  const size_t before = a.size_bytes();
  CHECK(a.drop_oldest() == kPose.size());
  CHECK(a.size_bytes() == before - kPose.size());
  CHECK(Bytes(a.head(), a.head() + 24) == part(kPose, 8, 32));
}

void a_restart_swallows_up_to_the_first_header() {
  FrameAssembler a(kHold);
  a.restart(0);
  put(a, part(kPose, 20, 32) + Bytes{0xff, 0x00} + kTwist, 5);
  CHECK(a.ready_bytes(kAll, 5) == kTwist.size());
  CHECK(a.swallowed_bytes() == 14);
}

void a_restart_swallows_up_to_a_quiet_time() {
  FrameAssembler a(kHold);
  a.restart(0);
  put(a, Bytes(7, 'x'), 5);
  CHECK(a.ready_bytes(kAll, 24) == 0);
  put(a, Bytes(64, 'y'), 25);
  CHECK(a.ready_bytes(kAll, 25) == 64);
}

void a_restart_does_not_swallow_without_end() {
  FrameAssembler a(kHold);
  a.restart(0);
  for (uint32_t i = 0; i < 10; ++i) put(a, Bytes(128, 'x'), i);
  CHECK(a.swallowed_bytes() == 1024);
  CHECK(a.ready_bytes(kAll, 10) == 256);
}

void the_backoff_doubles_to_its_limit_and_jitters() {
  Backoff backoff(4711);
  for (const uint32_t step_ms : {200u, 400u, 800u, 1600u, 1600u}) {
    const uint32_t delay_ms = backoff.next_ms();
    CHECK(delay_ms >= step_ms / 2 && delay_ms <= step_ms);
  }
  backoff.reset();
  CHECK(backoff.next_ms() <= 200);
  CHECK(Backoff(1).next_ms() != Backoff(9999).next_ms());
}

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
  CHECK(rig.uart.to_device.empty());  // the command stood where the proof had to
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

#define TEST(name) \
  { #name, name }
const std::pair<const char*, std::function<void()>> kTests[] = {
    TEST(a_frame_leaves_when_it_is_whole),
    TEST(whole_frames_leave_together_and_the_rest_waits),
    TEST(half_a_frame_leaves_after_a_quiet_time),
    TEST(half_a_frame_leaves_after_the_longest_time_although_bytes_drip),
    TEST(the_timeout_survives_the_wrap_of_the_clock),
    TEST(noise_leaves_when_a_frame_follows_or_when_it_is_long),
    TEST(a_bad_checksum_hides_no_frame),
    TEST(a_claim_over_the_limit_is_no_frame),
    TEST(a_cut_frame_goes_on_at_once),
    TEST(a_full_buffer_drops_the_oldest_frame_but_not_the_started_one),
    TEST(a_restart_swallows_up_to_the_first_header),
    TEST(a_restart_swallows_up_to_a_quiet_time),
    TEST(a_restart_does_not_swallow_without_end),
    TEST(the_backoff_doubles_to_its_limit_and_jitters),
    TEST(it_connects_when_the_wifi_is_up),
    TEST(it_requests_a_new_join_after_20_s),
    TEST(frames_pass_both_ways_each_in_one_write),
    TEST(half_a_command_never_reaches_the_device),
    TEST(a_new_link_begins_with_nothing_of_the_old_one_but_a_started_frame),
    TEST(what_came_while_the_link_was_down_is_not_sent),
    TEST(last_words_of_a_host_that_closes_reach_the_device),
    TEST(a_network_that_accepts_nothing_ends_the_link_after_2_s),
    TEST(partial_writes_lose_nothing),
    TEST(a_host_that_answers_no_time_request_ends_the_link),
    TEST(a_host_that_answers_keeps_the_link),
    TEST(a_stalled_network_drops_whole_old_frames),
    TEST(the_hmac_is_that_of_rfc_4231),
    TEST(with_a_key_nothing_passes_before_the_host_has_proven_it),
    TEST(a_host_that_requires_no_key_is_refused),
    TEST(a_host_that_sends_nothing_is_given_up),
    TEST(the_led_shows_the_state),
};
}  // namespace

int main() {
  for (const auto& [name, run] : kTests) {
    running = name;
    run();
  }
  std::printf("%zu tests, %d failures\n", std::size(kTests), failures);
  return failures == 0 ? 0 : 1;
}
