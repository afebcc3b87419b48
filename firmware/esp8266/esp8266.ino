// ESP8266 passthrough: UART to the device, TCP to the host. Wiring only; src/ decides.
#include <ros.h>  // the library: firmware/rosserial

#include "src/board/board.h"
#include "src/passthrough.h"
#include "src/status_led.h"
#ifdef HOSTLINK_SETTINGS
#include HOSTLINK_SETTINGS
#else
#include "settings.h"  // missing? Copy settings.example.h to settings.h and fill it in.
#endif

static board::SerialUart uart;
static board::WifiNetwork network;
static board::Updates updates;
static hostlink::Passthrough passthrough(uart, network, board::random_seed());

void setup() {
  const hostlink::Settings wanted = settings();
  uart.begin(wanted);
  network.begin(wanted);
  passthrough.set_key(wanted.key, board::random_seed);
  updates.begin(wanted);
  board::begin_led();
}

void loop() {
  passthrough.step(millis());
  if (passthrough.wants_connection(millis())) {
    const bool is_connected = network.connect();
    passthrough.connection_tried(is_connected, millis());
  }
  // Not while a host drives: an update occupies the processor for seconds and then restarts it.
  if (passthrough.state() != hostlink::LinkState::kConnected) updates.step();
  board::set_led(hostlink::is_led_lit(passthrough.state(), millis()));
  yield();
}
