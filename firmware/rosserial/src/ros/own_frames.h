// Contents of the frames that the node itself sends: announcements, lines of the log, names of parameters.
#pragma once

#include <string.h>

#include "node.h"

namespace ros {

struct Name {
  const char* first;
  const char* second;
};

struct Announcement {
  Name name;
  uint16_t id;
  FlashText type;
  FlashText md5;
  uint32_t buffer_bytes;
};

struct LogLine {
  Level level;
  FlashText flash;
  const char* chars;  // nullptr: the text is in the flash
  size_t size;
};

inline Name full_name(const char* name_space, const char* name) {
  const bool is_absolute = *name == '/' || *name == '~';
  return {is_absolute ? "" : name_space, name};
}

inline void put_chars(Writer& out, const char* chars) {
  while (*chars != '\0') out.put(static_cast<uint8_t>(*chars++));
}

inline void put_name(Writer& out, const Name& name) {
  out.put(static_cast<uint32_t>(strlen(name.first) + strlen(name.second)));
  put_chars(out, name.first);
  put_chars(out, name.second);
}

inline void put_flash(Writer& out, FlashText text, size_t size) {
  out.put(static_cast<uint32_t>(size));
  for (size_t i = 0; i < size; ++i) out.put(static_cast<uint8_t>(text[i]));
}

inline bool put_announcement(const void* message, Writer& out) {
  const Announcement& announcement = *static_cast<const Announcement*>(message);
  out.put(announcement.id);
  put_name(out, announcement.name);
  put_flash(out, announcement.type, announcement.type.size());
  put_flash(out, announcement.md5, announcement.md5.size());
  out.put(announcement.buffer_bytes);
  return out.is_good();
}

inline bool put_line(const void* message, Writer& out) {
  const LogLine& line = *static_cast<const LogLine*>(message);
  out.put(static_cast<uint8_t>(line.level));
  out.put(static_cast<uint32_t>(line.size));
  for (size_t i = 0; i < line.size; ++i) {
    out.put(static_cast<uint8_t>(line.chars == nullptr ? line.flash[i] : line.chars[i]));
  }
  return out.is_good();
}

// Of a topic: its name. A line of its own, so that a sketch without a log does not need the log's functions.
inline bool put_too_large(const void* message, Writer& out) {
  static const char text[] ROS_IN_FLASH = "message larger than buffer: ";
  const size_t size = sizeof text - 1;
  const char* name = static_cast<const char*>(message);
  out.put(static_cast<uint8_t>(Level::kError));
  out.put(static_cast<uint32_t>(size + strlen(name)));
  for (size_t i = 0; i < size; ++i) out.put(static_cast<uint8_t>(FlashText(text)[i]));
  put_chars(out, name);
  return out.is_good();
}

inline bool put_parameter_name(const void* message, Writer& out) {
  put_name(out, *static_cast<const Name*>(message));
  return out.is_good();
}

inline bool put_no_time(const void*, Writer& out) {
  out.put(Time());
  return out.is_good();
}

}  // namespace ros
