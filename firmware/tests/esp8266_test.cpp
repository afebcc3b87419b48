// Unit tests of the passthrough's pure part: tables of bytes and times, no port and no clock.
#include "esp8266_test.h"

int main() {
  run_assembler_tests();
  run_passthrough_tests();
  return test::report();
}
