// Shared declarations of the tests of the passthrough.
#pragma once

#include <hostlink/backoff.h>

#include "check.h"
#include "esp8266_board.h"
#include "src/passthrough.h"

using hostlink::Backoff;
using hostlink::FrameAssembler;
using hostlink::LinkEnd;
using hostlink::LinkState;
using hostlink::Passthrough;
using test::Bytes;
using test::frame;
using test::operator+;

constexpr size_t kAll = FrameAssembler::kCapacityBytes;
const Bytes kPose = frame(125, Bytes(24, 7));
const Bytes kTwist = frame(126, Bytes(48, 9));

inline Bytes part(const Bytes& bytes, size_t from, size_t to) {
  return Bytes(bytes.begin() + static_cast<std::ptrdiff_t>(from), bytes.begin() + static_cast<std::ptrdiff_t>(to));
}

void run_assembler_tests();
void run_passthrough_tests();
