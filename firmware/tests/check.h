// CHECK for the tests of the firmware's pure parts: no library, so that they run on a Cortex-M3 too.
#pragma once

#include <stdio.h>

namespace test {

struct Tally {
  int checks;
  int failures;
  const char* running;
};

inline Tally& tally() {
  static Tally counted = {0, 0, ""};
  return counted;
}

inline void check(bool is_so, const char* what, const char* file, int line) {
  ++tally().checks;
  if (is_so) return;
  ++tally().failures;
  printf("%s:%d: %s: %s\n", file, line, tally().running, what);
}

inline void run(const char* name, void (*function)()) {
  tally().running = name;
  function();
}

// The status of the process.
inline int report() {
  printf("%d checks, %d failed\n", tally().checks, tally().failures);
  return tally().failures == 0 ? 0 : 1;
}

}  // namespace test

#define CHECK(what) ::test::check((what), #what, __FILE__, __LINE__)
#define RUN(function) ::test::run(#function, function)
