// The Due's firmware on an emulated Cortex-M3. UART0 is the line to the host, UART1 a line of text for people. Motors
// and floor are host/world.h's, with the numbers in mps2::loaded_text(). QEMU has no baud rate, so
// host/uart_ring.h makes one, with the Due's 127 bytes as its buffer.
#include "../due/src/robot.h"
#include "../host/activity_recorder.h"
#include "../host/uart_ring.h"
#include "../host/world_hal.h"
#include "mps2.h"

extern "C" void leave(int status);

namespace {

const uint32_t kBaud = 38400;
const uint32_t kReportMs = 500;
const uint32_t kTicksPerSecond = 1000;
const size_t kInboxBytes = 512;  // between the interrupt and the loop; a power of two

// One writer (the interrupt), one reader (the loop): each owns its own index.
volatile uint8_t inbox[kInboxBytes];
volatile uint32_t inbox_written = 0;
volatile uint32_t inbox_read = 0;

bool is_inbox_full() { return inbox_written - inbox_read == kInboxBytes; }

void receive_bytes() {
  while (!is_inbox_full() && (mps2::uart0().state & mps2::kReceiveFull) != 0) {
    inbox[inbox_written % kInboxBytes] = static_cast<uint8_t>(mps2::uart0().data);
    inbox_written = inbox_written + 1;
  }
}

class QemuHal : public hostlink::WorldHal {
 public:
  void begin() {
    // A free-running counter: interrupts of a tick coalesce when the emulator is late.
    mps2::timer0().reload = 0xFFFFFFFFu;
    mps2::timer0().value = 0xFFFFFFFFu;
    mps2::timer0().control = 1;
    mps2::uart0().divider = 16;
    mps2::uart0().control = 1 | 2 | 8;  // transmit, receive, interrupt on receive
    mps2::uart1().divider = 16;
    mps2::uart1().control = 1;
    mps2::interrupt_enable() = 1;
    mps2::sys_tick().reload = mps2::kClockHz / kTicksPerSecond - 1;
    mps2::sys_tick().value = 0;
    mps2::sys_tick().control = 1 | 2 | 4;  // on, interrupt, processor clock
  }

  // Sleep until an event, at most a millisecond, so that the PC can do other work.
  void sleep() { __asm__ volatile("wfi" ::: "memory"); }

  uint32_t milliseconds() override { return static_cast<uint32_t>(now_us() / 1000); }
  uint32_t micros() override { return static_cast<uint32_t>(now_us()); }
  int read() override { return ring_.read(); }

  size_t write(const uint8_t* data, size_t size) override {
    // The line to the host has the same speed: bytes wait until their time.
    size_t accepted = 0;
    while (accepted < size && credit_bytes() > 0 && (mps2::uart0().state & mps2::kTransmitFull) == 0) {
      mps2::uart0().data = data[accepted++];
      sent_at_us_ += kByteUs;
    }
    return accepted;
  }

  // Work of the hardware between two turns of the loop.
  void run() {
    __asm__ volatile("cpsid i" ::: "memory");
    receive_bytes();  // bytes that waited while the inbox was full: they cause no new interrupt
    __asm__ volatile("cpsie i" ::: "memory");
    while (inbox_read != inbox_written && ring_.line_room() > 0) {
      ring_.put_on_line(inbox[inbox_read % kInboxBytes], micros());
      inbox_read = inbox_read + 1;
    }
    ring_.run_until(micros());
    world_.run_until(micros());
  }

  hostlink::World& world() { return world_; }
  uint32_t lost() const { return ring_.lost(); }

 private:
  static const uint32_t kByteUs = 260;
  static const uint32_t kBurstBytes = 8;  // what the line may send between two passes of the loop

  // Microseconds since the start, from the counter that counts down; called far more often than it wraps (171 s).
  uint64_t now_us() {
    const uint32_t count = 0xFFFFFFFFu - mps2::timer0().value;
    cycles_ += count - last_count_;
    last_count_ = count;
    return cycles_ / (mps2::kClockHz / 1000000);
  }

  uint32_t credit_bytes() {
    const uint32_t waited_us = micros() - sent_at_us_;
    if (waited_us > 0x80000000u) return 0;  // ahead of the line
    if (waited_us <= kBurstBytes * kByteUs) return waited_us / kByteUs;
    sent_at_us_ = micros() - kBurstBytes * kByteUs;
    return kBurstBytes;
  }

  hostlink::UartRing ring_{kBaud};
  uint64_t cycles_ = 0;
  uint32_t last_count_ = 0;
  uint32_t sent_at_us_ = 0;
};

QemuHal hal;
hostlink::Robot robot(hal);
hostlink::ActivityRecorder activity;
hostlink::WorldParameters parameters;

void print(const char* text) {
  for (; *text != '\0'; ++text) {
    while ((mps2::uart1().state & mps2::kTransmitFull) != 0) {
    }
    mps2::uart1().data = static_cast<uint8_t>(*text);
  }
}

void print_number(const char* name, int32_t value) {
  char digits[12];
  int at = 11;
  digits[at] = '\0';
  uint32_t rest = value < 0 ? 0u - static_cast<uint32_t>(value) : static_cast<uint32_t>(value);
  do {
    digits[--at] = static_cast<char>('0' + rest % 10);
    rest /= 10;
  } while (rest > 0);
  if (value < 0) digits[--at] = '-';
  print(name);
  print(digits + at);
}

}  // namespace

extern "C" void uart_interrupt() {
  mps2::uart0().interrupt = mps2::kReceiveFull;  // first clear, then drain: else the last byte's call is lost
  receive_bytes();
}

extern "C" int main() {
  hal.begin();
  const uint32_t wrong = hostlink::read_world(mps2::loaded_text(), parameters);
  if (wrong != 0) {
    print_number("world: no number of a world in line ", static_cast<int32_t>(wrong));
    print("\r\n");
    leave(1);
  }
  hal.world().be(parameters);
  robot.setup();
  uint32_t reported_at_ms = hal.milliseconds();
  for (;;) {
    hal.run();
    robot.loop();
    activity.update(hal.world(), robot.node().delivered(), hal.milliseconds());
    if (hal.milliseconds() - reported_at_ms >= kReportMs) {
      reported_at_ms += kReportMs;
      print_number("ms ", static_cast<int32_t>(hal.milliseconds()));
      print_number(" left ", static_cast<int32_t>(hal.world().left().speed_ticks_s()));
      print_number(" right ", static_cast<int32_t>(hal.world().right().speed_ticks_s()));
      print_number(" lost ", static_cast<int32_t>(hal.lost()));
      print_number(" got ", static_cast<int32_t>(robot.node().delivered()));
      print_number(" sent ", static_cast<int32_t>(robot.node().published()));
      print_number(" dropped ",
                   static_cast<int32_t>(robot.node().dropped_from_host() + robot.node().dropped_to_host()));
      print_number(" x_mm ", static_cast<int32_t>(hal.world().pose().x_m * 1000.0));
      print_number(" y_mm ", static_cast<int32_t>(hal.world().pose().y_m * 1000.0));
      print_number(" theta_mrad ", static_cast<int32_t>(hal.world().pose().theta_rad * 1000.0));
      print_number(" battery_mv ", static_cast<int32_t>(hal.world().battery_v() * 1000.0));
      print_number(" got_ms ", static_cast<int32_t>(activity.got_at_ms()));
      print_number(" rolled_ms ", static_cast<int32_t>(activity.rolled_at_ms()));
      print_number(" rolled_mm ", static_cast<int32_t>(hal.world().rolled_m() * 1000.0));
      print("\r\n");
    }
    hal.sleep();
  }
}
