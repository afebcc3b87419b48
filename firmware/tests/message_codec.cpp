// The codec of generated headers behind a pipe, for tests/property/test_board_headers.py. all_types.h is made by the
// test: it includes headers and defines ALL_TYPES(X), with X(name) for each class. Every buffer has its announced
// size, so that a sanitizer notices reads and writes outside it.
//
// Request: uint16 type, uint32 bytes of storage, uint32 room for the answer, uint32 bytes of payload, payload.
// Answer: uint8 outcome, uint32 bytes, the message as it was written again.
#include <stdio.h>
#include <stdlib.h>

#include "all_types.h"

namespace {

enum Outcome { kWritten, kNotRead, kNotWritten };

struct Request {
  uint8_t* payload;
  size_t size;
  void* storage;
  size_t storage_bytes;
  uint8_t* answer;
  size_t room;
};

template <class M>
Outcome write_again(const Request& request, size_t& answer_bytes) {
  M message;
  ros::Reader in(request.payload, request.size, request.storage, request.storage_bytes);
  if (!message.deserialize(in) || in.left() != 0) return kNotRead;
  ros::Writer out(request.answer, request.room);
  if (!message.serialize(out)) return kNotWritten;
  answer_bytes = out.size();
  return kWritten;
}

// A double that is read as a float, like on a board whose double has 4 bytes.
Outcome narrow(const Request& request, size_t& answer_bytes) {
  ros::Reader in(request.payload, request.size, request.storage, request.storage_bytes);
  uint64_t bits = 0;
  in.get(bits);
  ros::Writer out(request.answer, request.room);
  const float value = ros::float_of_float64_bits(bits);
  out.put(value);
  out.put(ros::float64_bits_of_float(value));
  answer_bytes = out.size();
  return kWritten;
}

typedef Outcome (*Codec)(const Request& request, size_t& answer_bytes);

const Codec kCodecs[] = {narrow,
#define ENTRY(name) write_again<name>,
                         ALL_TYPES(ENTRY)
#undef ENTRY
};

bool read_all(void* bytes, size_t size) { return size == 0 || fread(bytes, 1, size, stdin) == size; }

}  // namespace

int main() {
  uint16_t type = 0;
  uint32_t sizes[3];
  while (read_all(&type, sizeof type) && read_all(sizes, sizeof sizes)) {
    Request request = {};
    request.storage_bytes = sizes[0];
    request.room = sizes[1];
    request.size = sizes[2];
    request.payload = static_cast<uint8_t*>(malloc(request.size));
    const size_t offset = request.size % 8;  // a storage that begins anywhere
    char* const storage = static_cast<char*>(malloc(request.storage_bytes + offset));
    request.storage = storage + offset;
    request.answer = static_cast<uint8_t*>(malloc(request.room));
    if (!read_all(request.payload, request.size) || type >= sizeof kCodecs / sizeof kCodecs[0]) return 1;
    size_t answer_bytes = 0;
    const uint8_t outcome = static_cast<uint8_t>(kCodecs[type](request, answer_bytes));
    const uint32_t size = static_cast<uint32_t>(answer_bytes);
    fwrite(&outcome, 1, sizeof outcome, stdout);
    fwrite(&size, 1, sizeof size, stdout);
    if (size > 0) fwrite(request.answer, 1, size, stdout);
    free(request.payload);
    free(storage);
    free(request.answer);
  }
  return 0;
}
