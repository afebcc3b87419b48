// Parameters with defaults, requested one after the other after each request of the host for topics, without waiting.
#pragma once

#include "node.h"

namespace ros {

class ParameterBase {
 public:
  const char* name() const { return name_; }
  bool is_from_host() const { return is_from_host_; }  // otherwise the default applies

 protected:
  // False: the answer is invalid, and the present value stays.
  typedef bool (*Use)(ParameterBase& self, ParameterAnswer& answer);

  ParameterBase(const char* name, Use use) : name_(name), use_(use) {}
  ParameterBase(const ParameterBase&) = delete;
  ParameterBase& operator=(const ParameterBase&) = delete;
  ~ParameterBase() {}

 private:
  friend class Parameters;

  const char* name_;
  Use use_;
  ParameterBase* next_ = nullptr;
  bool is_from_host_ = false;
};

// A number (int, float, bool), or `kCount` of them.
template <class T, size_t kCount = 1>
class Parameter : public ParameterBase {
 public:
  Parameter(const char* name, T value) : Parameter(name, value, value, value) { has_range_ = false; }
  // A value outside `low` to `high` is refused, with a line in the host's log.
  Parameter(const char* name, T value, T low, T high) : ParameterBase(name, &Parameter::use), low_(low), high_(high) {
    for (size_t i = 0; i < kCount; ++i) values_[i] = value;
  }

  operator T() const { return values_[0]; }
  T value() const { return values_[0]; }
  T operator[](size_t at) const { return values_[at]; }

 private:
  static bool use(ParameterBase& self, ParameterAnswer& answer) {
    Parameter& parameter = static_cast<Parameter&>(self);
    T values[kCount];
    if (!answer.copy(values, kCount)) return false;
    for (size_t i = 0; parameter.has_range_ && i < kCount; ++i) {
      if (!(values[i] >= parameter.low_ && values[i] <= parameter.high_)) return false;  // NaN is not
    }
    memcpy(parameter.values_, values, sizeof values);
    return true;
  }

  T values_[kCount];
  T low_;
  T high_;
  bool has_range_ = true;
};

// A text of at most kChars - 1 characters.
template <size_t kChars>
class TextParameter : public ParameterBase {
 public:
  TextParameter(const char* name, const char* text) : ParameterBase(name, &TextParameter::use) {
    strncpy(text_, text, kChars - 1);
  }

  const char* text() const { return text_; }

 private:
  static bool use(ParameterBase& self, ParameterAnswer& answer) {
    return answer.text(0, static_cast<TextParameter&>(self).text_, kChars);
  }

  char text_[kChars] = {};
};

/*
  attach() it to the node after add() of each parameter.

  state      event                                                next
  any        the host has asked for the topics                    the first is requested
  requested  the answer came, or none for a second                the next one, when it may be requested; or is_done()
  any        the host is gone                                     idle

  On a UART a host that asks for the topics again may be another one. Until its answers come, what applied does, and
  is_done() stays.
*/
class Parameters : public Task {
 public:
  void add(ParameterBase& parameter);
  bool is_done() const { return is_done_; }  // each was requested, and set if the host answered

 private:
  void spin(Node& node) override;
  void receive(ParameterAnswer& answer);
  static void receive(void* self, ParameterAnswer& answer) { static_cast<Parameters*>(self)->receive(answer); }

  ParameterBase* first_ = nullptr;
  ParameterBase* requested_ = nullptr;
  uint32_t requested_at_ms_ = 0;
  uint8_t announcements_ = 0;
  bool is_requested_ = false;  // whether the value is the host's, otherwise it is still to be requested
  bool was_configured_ = false;
  bool is_answered_ = false;
  bool is_done_ = false;
};

}  // namespace ros
