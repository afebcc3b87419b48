// Stand-in for the updates over the air of both cores.
#pragma once

class ArduinoOTAClass {
 public:
  void setHostname(const char* name);
  void setPassword(const char* password);
  template <class F>
  void onStart(F) {}  // the cores take a std::function, which the compiler of the chips does not have here
  void begin();
  void handle();
};

extern ArduinoOTAClass ArduinoOTA;
