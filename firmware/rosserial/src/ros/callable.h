// A callback without a heap: a function, a lambda that captures little, or an object and its member.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <string.h>

namespace ros {

#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ < 5
#define ROS_IS_PLAIN(type) __has_trivial_copy(type)
#else
#define ROS_IS_PLAIN(type) __is_trivially_copyable(type)
#endif

// A member function of an object, which may belong to a derived class.
template <class Object, class Member>
struct MemberOf {
  Member member;
  Object* object;

  template <class... Arguments>
  void operator()(Arguments&... arguments) {
    (object->*member)(arguments...);
  }
};

template <class Signature>
class Callable;

template <class... Arguments>
class Callable<void(Arguments...)> {
 public:
  static const size_t kBytes = 3 * sizeof(void*);  // a member and its object; a lambda with as many references

  Callable() {}

  template <class F>
  Callable(F function) : call_(&call<F>) {  // NOLINT: a function converts, as in ros_lib
    static_assert(sizeof(F) <= kBytes, "the lambda captures too much: at most three references");
    static_assert(ROS_IS_PLAIN(F), "the lambda captures an object that cannot be copied byte by byte");
    memcpy(memory_.bytes, &function, sizeof function);
  }

  template <class T>
  Callable(void (T::*member)(Arguments...), T* object) : Callable(Member<T>{member, object}) {}

  explicit operator bool() const { return call_ != nullptr; }
  void operator()(Arguments... arguments) {
    if (call_ != nullptr) call_(memory_.bytes, arguments...);
  }

 private:
  template <class T>
  struct Member {
    void (T::*member)(Arguments...);
    T* object;
    void operator()(Arguments... arguments) { (object->*member)(arguments...); }
  };

  template <class F>
  static void call(void* memory, Arguments... arguments) {
    (*static_cast<F*>(memory))(arguments...);
  }

  union Memory {
    void* alignment;
    unsigned char bytes[kBytes];
  };

  Memory memory_ = {};
  void (*call_)(void*, Arguments...) = nullptr;
};

}  // namespace ros
