// The pattern of the paper's passthrough, kept to show that the stand-in finds its defects: an unbounded
// read into 128 bytes, and waiting for the WiFi without a yield.
#include "ESP8266WiFi.h"
#include "native_settings.h"

namespace {
WiFiClient client;
uint8_t bytes[128];
}  // namespace

void setup() {
  Serial.begin(38400);
  WiFi.begin("here", "");
}

void loop() {
  const hostlink::Settings wanted = settings();
  while (WiFi.status() != WL_CONNECTED) {
  }
  if (!client.connected()) client.connect(wanted.server, wanted.server_port);
  const int count = client.available();
  if (count > 0) {
    client.read(bytes, static_cast<size_t>(count));
    Serial.write(bytes, static_cast<size_t>(count));
  }
}
