#!/usr/bin/env bash
# Compiles and links due.ino and src/board/ with a genuine Arduino core and an old compiler: Debian's arduino-core-avr for a Mega
# 2560. It proves the Arduino API and old C++11, no numbers: int has 16 bits there. The Due's own core is not in Debian.
set -euo pipefail
firmware=$(cd "$(dirname "$0")/.." && pwd)
build=$firmware/../build/firmware/avr
core=/usr/share/arduino/hardware/arduino/avr
mkdir -p "$build/core" "$build/due"
flags=(-mmcu=atmega2560 -DF_CPU=16000000L -DARDUINO=10819 -DARDUINO_AVR_MEGA2560 -DARDUINO_ARCH_AVR -DDECIMAL_DIG=17 -Os
  -ffunction-sections -fdata-sections -I"$core/cores/arduino" -I"$core/variants/mega")
if [ ! -f "$build/core.a" ]; then
  for source in "$core"/cores/arduino/*.c; do avr-gcc "${flags[@]}" -w -c "$source" -o "$build/core/$(basename "$source").o"; done
  for source in "$core"/cores/arduino/*.cpp; do
    avr-g++ "${flags[@]}" -w -std=gnu++11 -fno-exceptions -fno-threadsafe-statics -c "$source" -o "$build/core/$(basename "$source").o"
  done
  avr-ar rcs "$build/core.a" "$build"/core/*.o
fi
library=$firmware/rosserial/src
strict=(-std=gnu++11 -fno-exceptions -fno-threadsafe-statics -Wall -Wextra -Werror -I"$library")
# The IDE puts Arduino.h in front of a sketch.
rm -f "$build"/due/*.o
avr-g++ "${flags[@]}" "${strict[@]}" -I"$firmware/due" -include Arduino.h -x c++ -c "$firmware/due/due.ino" -o "$build/due/due.ino.o"
for source in "$firmware"/due/src/*.cpp "$firmware"/due/src/board/*.cpp "$library"/ros/*.cpp; do
  avr-g++ "${flags[@]}" "${strict[@]}" -c "$source" -o "$build/due/$(basename "$source").o"
done
avr-gcc -mmcu=atmega2560 -Wl,--gc-sections "$build"/due/*.o "$build/core.a" -lm -o "$build/due.elf"
avr-size -C --mcu=atmega2560 "$build/due.elf" | grep -E 'Program|Data'
