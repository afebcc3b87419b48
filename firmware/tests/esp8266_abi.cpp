// The pure part of the passthrough with C linkage, for the property tests in Python.
#include "esp8266_board.h"
#include "src/passthrough.h"

using hostlink::FrameAssembler;
using test::Bytes;

namespace {
struct Bridge {
  test::MemoryUart uart;
  test::MemoryNetwork network;
  hostlink::Passthrough passthrough{uart, network, 1};
};

uint32_t next_random() {
  static uint32_t state = 1;
  return state = state * 1664525u + 1013904223u;
}

size_t move_all(Bytes& from, uint8_t* to, size_t limit) { return test::move_out(from, to, limit); }
}  // namespace

extern "C" {
FrameAssembler* assembler_new(uint32_t quiet_ms, uint32_t longest_ms) {
  return new FrameAssembler({quiet_ms, longest_ms});
}
void assembler_delete(FrameAssembler* a) { delete a; }
void assembler_restart(FrameAssembler* a, uint32_t now_ms) { a->restart(now_ms); }
size_t assembler_put(FrameAssembler* a, const uint8_t* bytes, size_t count, uint32_t now_ms) {
  return a->put(bytes, count, now_ms);
}
size_t assembler_size(FrameAssembler* a) { return a->size_bytes(); }
size_t assembler_capacity() { return FrameAssembler::kCapacityBytes; }
size_t assembler_ready(FrameAssembler* a, size_t limit, uint32_t now_ms) { return a->ready_bytes(limit, now_ms); }
void assembler_take(FrameAssembler* a, uint8_t* to, size_t count) {
  std::copy_n(a->head(), count, to);
  a->take(count);
}
size_t assembler_drop_oldest(FrameAssembler* a) { return a->drop_oldest(); }

void sha256(const uint8_t* bytes, size_t count, size_t cut, uint8_t* digest) {
  hostlink::Sha256 hash;
  hash.add(bytes, cut);
  hash.add(bytes + cut, count - cut);
  hash.finish(digest);
}
void hmac_sha256(const uint8_t* key, size_t key_bytes, const uint8_t* bytes, size_t count, uint8_t* digest) {
  hostlink::HmacSha256 hmac(key, key_bytes);
  hmac.add(bytes, count);
  hmac.finish(digest);
}

Bridge* bridge_new() { return new Bridge; }
// The key must outlive the bridge.
void bridge_set_key(Bridge* b, const char* key) { b->passthrough.set_key(key, next_random); }
void bridge_delete(Bridge* b) { delete b; }
// One turn of the sketch's loop(); returns whether a link is up.
int bridge_turn(Bridge* b, uint32_t now_ms) {
  b->passthrough.step(now_ms);
  if (b->passthrough.wants_connection(now_ms)) b->passthrough.connection_tried(b->network.connect(), now_ms);
  return b->passthrough.state() == hostlink::LinkState::kConnected ? 1 : 0;
}
void bridge_from_device(Bridge* b, const uint8_t* bytes, size_t count) {
  b->uart.from_device.insert(b->uart.from_device.end(), bytes, bytes + count);
}
void bridge_from_host(Bridge* b, const uint8_t* bytes, size_t count) {
  b->network.from_host.insert(b->network.from_host.end(), bytes, bytes + count);
}
void bridge_set_room(Bridge* b, size_t to_device, size_t to_host) {
  b->uart.room = to_device;
  b->network.room = to_host;
}
void bridge_set_signal(Bridge* b, int dbm) { b->network.signal = dbm; }
void bridge_lose(Bridge* b) { b->network.connected = false; }
void bridge_set_joined(Bridge* b, int is_joined) { b->network.joined = is_joined != 0; }
size_t bridge_to_device(Bridge* b, uint8_t* to, size_t limit) { return move_all(b->uart.to_device, to, limit); }
// The oldest write to the host, 0 when there is none.
size_t bridge_to_host(Bridge* b, uint8_t* to, size_t limit) {
  if (b->network.writes.empty()) return 0;
  Bytes first = b->network.writes.front();
  b->network.writes.erase(b->network.writes.begin());
  return move_all(first, to, limit);
}
int bridge_is_overrun(Bridge* b) { return b->uart.is_overrun ? 1 : 0; }
uint32_t bridge_dropped(Bridge* b) { return b->passthrough.counters().from_device_dropped_bytes; }
}
