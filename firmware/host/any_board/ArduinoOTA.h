// Stand-in: never receives an update.
#pragma once

#include <functional>

class ArduinoOTAClass {
 public:
  void setHostname(const char*) {}
  void setPassword(const char*) {}
  void onStart(std::function<void()>) {}
  void begin() {}
  void handle() {}
};

static ArduinoOTAClass ArduinoOTA;
