// Stand-in for ArduinoOTA: no update is ever requested here.
#pragma once

class ArduinoOTAClass {
 public:
  void setHostname(const char*) {}
  void setPassword(const char*) {}
  void begin(bool uses_mdns = true) { has_mdns_ = uses_mdns; }
  void handle() {}

 private:
  bool has_mdns_ = true;
};

inline ArduinoOTAClass ArduinoOTA;
