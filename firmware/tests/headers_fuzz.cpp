// libFuzzer: any bytes into the generated headers of all types in all_types.h, which tests/support/headers_fuzzer.py
// writes. A message that a header accepts is written in as many bytes or fewer, and a second time unchanged. A buffer
// has its announced size, so that the sanitizer notices reads and writes outside it.
//
// Input: uint16 type, uint16 bytes of storage, payload.
#include <stdlib.h>
#include <string.h>

#include "all_types.h"

namespace {

struct Copy {
  explicit Copy(const uint8_t* from, size_t count) : bytes(static_cast<uint8_t*>(malloc(count))), size(count) {
    if (count > 0 && from != nullptr) memcpy(bytes, from, count);
  }
  ~Copy() { free(bytes); }
  Copy(const Copy&) = delete;
  Copy& operator=(const Copy&) = delete;

  uint8_t* bytes;
  size_t size;
};

// The size of the message when it is written again; -1: refused.
template <class M>
long write_again(const uint8_t* payload, size_t size, size_t storage_bytes, uint8_t* out_bytes) {
  Copy in_bytes(payload, size);
  Copy storage(nullptr, storage_bytes);
  M message;
  ros::Reader in(in_bytes.bytes, size, storage.bytes, storage_bytes);
  if (!message.deserialize(in) || in.left() != 0) return -1;
  ros::Writer out(out_bytes, size);
  if (!message.serialize(out)) abort();
  return static_cast<long>(out.size());
}

template <class M>
void check(const uint8_t* payload, size_t size, size_t storage_bytes) {
  Copy once(nullptr, size);
  const long written = write_again<M>(payload, size, storage_bytes, once.bytes);
  if (written < 0) return;
  if (!M::getSize().has(size)) abort();
  Copy twice(nullptr, static_cast<size_t>(written));
  const long same = write_again<M>(once.bytes, static_cast<size_t>(written), storage_bytes, twice.bytes);
  if (same != written || memcmp(once.bytes, twice.bytes, static_cast<size_t>(written)) != 0) abort();
}

typedef void (*Check)(const uint8_t* payload, size_t size, size_t storage_bytes);

#define ENTRY(name) check<name>,
const Check kChecks[] = {ALL_TYPES(ENTRY)};
#undef ENTRY

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size < 4) return 0;
  const size_t type = static_cast<size_t>(data[0] | data[1] << 8) % (sizeof kChecks / sizeof kChecks[0]);
  kChecks[type](data + 4, size - 4, static_cast<size_t>(data[2] | data[3] << 8));
  return 0;
}
