// The library's node against a host that is scripted (rosserial_test.h), natively and on a Cortex-M3: a plain main, so
// that it runs where there is no library.
#include "rosserial_test.h"

int main() {
  run_topics_tests();
  run_calls_tests();
  run_time_tests();
  run_hostile_tests();
  run_hosts_tests();
  run_passthrough_tests();
  return test::report();
}
