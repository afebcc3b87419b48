// Frames in a byte stream, and when they may be sent.
#include "esp8266_test.h"

namespace {

constexpr hostlink::Hold kHold = {20, 500};

size_t put(FrameAssembler& a, const Bytes& bytes, uint32_t now_ms) { return a.put(bytes.data(), bytes.size(), now_ms); }

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

}  // namespace

void run_assembler_tests() {
  RUN(a_frame_leaves_when_it_is_whole);
  RUN(whole_frames_leave_together_and_the_rest_waits);
  RUN(half_a_frame_leaves_after_a_quiet_time);
  RUN(half_a_frame_leaves_after_the_longest_time_although_bytes_drip);
  RUN(the_timeout_survives_the_wrap_of_the_clock);
  RUN(noise_leaves_when_a_frame_follows_or_when_it_is_long);
  RUN(a_bad_checksum_hides_no_frame);
  RUN(a_claim_over_the_limit_is_no_frame);
  RUN(a_cut_frame_goes_on_at_once);
  RUN(a_full_buffer_drops_the_oldest_frame_but_not_the_started_one);
  RUN(a_restart_swallows_up_to_the_first_header);
  RUN(a_restart_swallows_up_to_a_quiet_time);
  RUN(a_restart_does_not_swallow_without_end);
  RUN(the_backoff_doubles_to_its_limit_and_jitters);
}
