// The sketches in a program with this board; tests/firmware/examples.py writes their table.
#pragma once

struct Sketch {
  const char* name;
  void (*setup)();
  void (*loop)();
};

extern const Sketch kSketches[];
extern const int kSketchCount;
