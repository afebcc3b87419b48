// The first of two boards: an ESP8266 or ESP32 that connects a board without a network to a host. The other board runs
// any sketch of this library, or of ros_lib, on its Serial at 57600 baud: its TX to our RX, its RX to our TX, GND to
// GND. A 5 V board needs a level shifter. Its motors stop at once when the connection to the host is lost.
#include <hostlink/link_passthrough.h>
#include <hostlink/stream_hardware.h>
#include <hostlink/wifi.h>
#include <ros.h>

const char kWifiName[] = "workshop";
const char kWifiPassword[] = "secret";
const char kHost[] = "192.168.0.10";

hostlink::StreamHardware device(&Serial, 57600);
hostlink::WifiHardware host;
hostlink::WifiStation wifi;
hostlink::LinkPassthrough<> passthrough(device, host);

void setup() {
#if defined(ESP8266) || defined(ESP32)
  Serial.setRxBufferSize(1024);  // the core's own timeout is 45 ms, that of connect() a second
#endif
  device.init();
  wifi.begin(kWifiName, kWifiPassword, "passthrough");
  host.setConnection(kHost);
  host.init();
}

void loop() {
  wifi.spin();
  passthrough.spin();
}
