// Updates over the air of an ESP8266 or an ESP32. The loop does not run during an update, so no robot may drive.
//   #include <ArduinoOTA.h>
//   #include <hostlink/updates.h>
//   hostlink::Updates<ArduinoOTAClass> updates(ArduinoOTA, watchdog);  // without motors: updates(ArduinoOTA)
// docs/arduino.md#updates-over-the-air
#pragma once

#include "command_watchdog.h"

namespace hostlink {

template <class Ota>
class Updates {
 public:
  explicit Updates(Ota& ota) : ota_(ota) {}
  // The watchdog's motors are stopped before an update begins, and no update begins while they are commanded.
  Updates(Ota& ota, CommandWatchdog& watchdog) : ota_(ota), watchdog_(&watchdog) {}

  // Without a password updates are off. Both texts must stay valid.
  void begin(const char* name, const char* password) {
    if (password[0] == '\0' || is_on_) return;
    is_on_ = true;
    if (name[0] != '\0') ota_.setHostname(name);
    ota_.setPassword(password);
    ota_.onStart([this]() { stop(); });  // an update that was requested before the drive may begin after it
    ota_.begin();
  }

  // One turn: call it in loop().
  void spin() {
    const bool is_driven = watchdog_ != nullptr && watchdog_->is_running();
    if (is_on_ && !is_driven) ota_.handle();
  }

 private:
  void stop() {
    if (watchdog_ != nullptr) watchdog_->stop();
  }

  Ota& ota_;
  CommandWatchdog* watchdog_ = nullptr;
  bool is_on_ = false;
};

}  // namespace hostlink
