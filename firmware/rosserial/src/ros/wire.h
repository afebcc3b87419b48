// The codec of messages: ROS 1's serialisation, little-endian on every board, each length checked. No heap.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "duration.h"
#include "time.h"

namespace ros {

// The texts of a string[]. The array belongs to the sketch; char* or const char*.
class Texts {
 public:
  Texts(decltype(nullptr) = nullptr) {}
  Texts(const char** texts) : texts_(texts) {}
  Texts(char** texts) : texts_(const_cast<const char**>(texts)) {}

  const char*& operator[](size_t i) const { return texts_[i]; }
  explicit operator bool() const { return texts_ != nullptr; }

 private:
  const char** texts_ = nullptr;
};

// The numbers of a float64[]. The array belongs to the sketch; double, or float like in ros_lib.
class Doubles {
 public:
  class Number {
   public:
    Number(const Doubles& numbers, size_t at) : numbers_(numbers), at_(at) {}
    operator double() const { return numbers_.at(at_); }
    Number& operator=(double value) {
      numbers_.set(at_, value);
      return *this;
    }

   private:
    const Doubles& numbers_;
    size_t at_;
  };

  Doubles(decltype(nullptr) = nullptr) {}
  Doubles(double* values) : doubles_(values) {}
  Doubles(float* values) : floats_(values) {}

  Number operator[](size_t i) const { return Number(*this, i); }
  explicit operator bool() const { return doubles_ != nullptr || floats_ != nullptr; }
  double at(size_t i) const { return floats_ == nullptr ? doubles_[i] : static_cast<double>(floats_[i]); }
  void set(size_t i, double value) const {
    if (floats_ == nullptr) {
      doubles_[i] = value;
    } else {
      floats_[i] = static_cast<float>(value);
    }
  }

 private:
  double* doubles_ = nullptr;
  float* floats_ = nullptr;
};

// A float64 has 8 bytes on the wire, also where double has 4: these functions convert its bits from and to a double.
uint64_t float64_bits(double value);
double float64_value(uint64_t bits);
uint64_t float64_bits_of_float(float value);
float float_of_float64_bits(uint64_t bits);  // rounds to the nearest; too large: infinite, too small: zero

// Writes a message into bytes. A field that does not fit is not written, nor are the fields after it.
class Writer {
 public:
  Writer(uint8_t* bytes, size_t size) : bytes_(bytes), room_(size) {}

  bool is_good() const { return is_good_; }
  size_t size() const { return size_; }  // counts fields that do not fit too: the size that the message needs

  void put(bool value) { put_number(value ? 1u : 0u, 1); }
  void put(int8_t value) { put_number(static_cast<uint8_t>(value), 1); }
  void put(uint8_t value) { put_number(value, 1); }
  void put(int16_t value) { put_number(static_cast<uint16_t>(value), 2); }
  void put(uint16_t value) { put_number(value, 2); }
  void put(int32_t value) { put_number(static_cast<uint32_t>(value), 4); }
  void put(uint32_t value) { put_number(value, 4); }
  void put(int64_t value) { put_long(static_cast<uint64_t>(value)); }
  void put(uint64_t value) { put_long(value); }
  void put(float value);
  void put(double value) { put_long(float64_bits(value)); }
  void put(const char* text);  // nullptr: an empty text
  void put(const Time& time) {
    put(time.sec);
    put(time.nsec);
  }
  void put(const Duration& duration) {
    put(duration.sec);
    put(duration.nsec);
  }
  template <class M>
  void put(const M& message) {
    message.serialize(*this);
  }

  template <class T, size_t N>
  void put_fixed(const T (&values)[N]) {
    for (size_t i = 0; i < N; ++i) put(values[static_cast<size_t>(i)]);
  }
  template <class A>
  void put_variable(const A& values, uint32_t count) {
    put(count);
    if (!values) {
      is_good_ = is_good_ && count == 0;
      return;
    }
    for (uint32_t i = 0; i < count; ++i) put(values[static_cast<size_t>(i)]);
  }
  void put(const Doubles::Number& value) { put(static_cast<double>(value)); }

 private:
  uint8_t* claim(size_t size);  // nullptr: it does not fit
  void put_number(uint32_t value, size_t size);
  void put_long(uint64_t value);

  uint8_t* bytes_;
  size_t room_;
  size_t size_ = 0;
  bool is_good_ = true;
};

// Reads a message from bytes, which must stay as long as the message is used: a text is not copied. It moves over its
// length, and a zero ends it. Variable arrays are put into `storage`.
class Reader {
 public:
  Reader(uint8_t* bytes, size_t size, void* storage, size_t storage_bytes)
      : bytes_(bytes), left_(size), storage_(static_cast<uint8_t*>(storage)), storage_left_(storage_bytes) {}

  bool is_good() const { return is_good_; }
  size_t left() const { return left_; }  // whether bytes follow the message

  void get(bool& value) { value = get_number(1) != 0; }
  void get(int8_t& value) { value = static_cast<int8_t>(get_number(1)); }
  void get(uint8_t& value) { value = static_cast<uint8_t>(get_number(1)); }
  void get(int16_t& value) { value = static_cast<int16_t>(get_number(2)); }
  void get(uint16_t& value) { value = static_cast<uint16_t>(get_number(2)); }
  void get(int32_t& value) { value = static_cast<int32_t>(get_number(4)); }
  void get(uint32_t& value) { value = get_number(4); }
  void get(int64_t& value) { value = static_cast<int64_t>(get_long()); }
  void get(uint64_t& value) { value = get_long(); }
  void get(float& value);
  void get(double& value) { value = float64_value(get_long()); }
  void get(const char*& text);
  void get(Time& time) {
    get(time.sec);
    get(time.nsec);
  }
  void get(Duration& duration) {
    get(duration.sec);
    get(duration.nsec);
  }
  template <class M>
  void get(M& message) {
    message.deserialize(*this);
  }

  template <class T, size_t N>
  void get_fixed(T (&values)[N]) {
    for (size_t i = 0; i < N && is_good_; ++i) get(values[i]);
  }
  // `least`: the minimum size of an element in bytes.
  template <class T>
  void get_variable(T*& values, uint32_t& count, size_t least) {
    count = get_count(least);
    values = static_cast<T*>(allocate(count, sizeof(T), alignof(T)));
    if (values == nullptr) count = 0;
    for (uint32_t i = 0; i < count && is_good_; ++i) get(*new (Place(values + i)) T());
  }
  void get_variable(uint8_t*& values, uint32_t& count, size_t least);
  void get_variable(Texts& texts, uint32_t& count, size_t least) {
    const char** values = nullptr;
    get_variable(values, count, least);
    texts = values;
  }
  void get_variable(Doubles& numbers, uint32_t& count, size_t least) {
    double* values = nullptr;
    get_variable(values, count, least);
    numbers = values;
  }

  // Place to construct an element; the boards' cores have the usual function in different headers.
  struct Place {
    explicit Place(void* memory) : at(memory) {}
    void* at;
  };

 private:
  uint8_t* claim(size_t size);  // nullptr: fewer bytes are left
  uint32_t get_number(size_t size);
  uint64_t get_long();
  uint32_t get_count(size_t least);
  void* allocate(uint32_t count, size_t size, size_t alignment);

  uint8_t* bytes_;
  size_t left_;
  uint8_t* storage_;
  size_t storage_left_;
  bool is_good_ = true;
};

}  // namespace ros

inline void* operator new(size_t, ros::Reader::Place place) noexcept { return place.at; }
