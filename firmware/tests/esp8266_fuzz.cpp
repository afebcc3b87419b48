// libFuzzer: any bytes at any times through the assembler. The order is kept, no byte is lost, added or held back, and
// memory is bounded.
#include <cstdlib>

#include "esp8266_board.h"
#include "src/frame_assembler.h"

using hostlink::FrameAssembler;
using test::Bytes;

namespace {
void require(bool is_true) {
  if (!is_true) std::abort();
}

void take(FrameAssembler& assembler, size_t count, Bytes& out) {
  out.insert(out.end(), assembler.head(), assembler.head() + count);
  assembler.take(count);
}
}  // namespace

// Each step: one byte for the number of bytes, one for the time, one for the room, then the bytes.
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  FrameAssembler assembler({20, 500});
  Bytes in, out;
  uint32_t now_ms = 0xffffff00u;
  size_t at = 0;
  while (at + 3 <= size) {
    const size_t count = std::min<size_t>(data[at], size - at - 3);
    now_ms += data[at + 1] % 32u;
    const size_t room = data[at + 2] * 8u;
    const uint8_t* bytes = data + at + 3;
    at += 3 + count;
    const size_t taken = assembler.put(bytes, count, now_ms);
    in.insert(in.end(), bytes, bytes + taken);
    require(taken == count || assembler.room_bytes() == 0);
    const size_t ready = assembler.ready_bytes(room, now_ms);
    require(ready <= room && ready <= assembler.size_bytes());
    assembler.has_frame(10, ready);
    take(assembler, ready, out);
    if (assembler.room_bytes() == 0) require(assembler.ready_bytes(FrameAssembler::kCapacityBytes, now_ms) > 0);
  }
  now_ms += 20;
  while (assembler.size_bytes() > 0) {
    const size_t ready = assembler.ready_bytes(FrameAssembler::kCapacityBytes, now_ms);
    require(ready > 0);
    take(assembler, ready, out);
  }
  require(in == out);
  return 0;
}
