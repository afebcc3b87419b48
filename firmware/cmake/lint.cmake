# What needs no run: format and lint of everything that is C++ here but the vendor-like names of host/arduino.
find_program(CLANG_FORMAT NAMES clang-format clang-format-14)
find_program(CLANG_TIDY NAMES clang-tidy clang-tidy-14)
find_program(CPPCHECK cppcheck)
file(GLOB DUE_ALL ${CMAKE_CURRENT_SOURCE_DIR}/due/due.ino ${CMAKE_CURRENT_SOURCE_DIR}/due/src/*.h
     ${CMAKE_CURRENT_SOURCE_DIR}/due/src/*.cpp ${CMAKE_CURRENT_SOURCE_DIR}/due/src/board/*
     ${CMAKE_CURRENT_SOURCE_DIR}/rosserial/src/*.h ${CMAKE_CURRENT_SOURCE_DIR}/rosserial/src/ros/*
     ${CMAKE_CURRENT_SOURCE_DIR}/host/*.h ${CMAKE_CURRENT_SOURCE_DIR}/host/*.cpp
     ${CMAKE_CURRENT_SOURCE_DIR}/host/due_arduino/* ${CMAKE_CURRENT_SOURCE_DIR}/qemu/*.h
     ${CMAKE_CURRENT_SOURCE_DIR}/qemu/*.cpp ${CMAKE_CURRENT_SOURCE_DIR}/tests/due_*.cpp
     ${CMAKE_CURRENT_SOURCE_DIR}/rosserial/src/hostlink/* ${CMAKE_CURRENT_SOURCE_DIR}/rosserial/src/tf/*
     ${CMAKE_CURRENT_SOURCE_DIR}/rosserial/examples/*/*.ino ${CMAKE_CURRENT_SOURCE_DIR}/host/any_board/*
     ${CMAKE_CURRENT_SOURCE_DIR}/tests/rosserial_* ${CMAKE_CURRENT_SOURCE_DIR}/tests/check.h ${CMAKE_CURRENT_SOURCE_DIR}/tests/links_test.cpp
     ${CMAKE_CURRENT_SOURCE_DIR}/tests/headers_fuzz.cpp
     ${CMAKE_CURRENT_SOURCE_DIR}/tests/ros_lib_sketches/*.ino ${CMAKE_CURRENT_SOURCE_DIR}/host/esp/*.h
     ${CMAKE_CURRENT_SOURCE_DIR}/host/esp/lwip/*.h ${CMAKE_CURRENT_SOURCE_DIR}/host/avr_libraries/*.h
     ${CMAKE_CURRENT_SOURCE_DIR}/host/avr_emulator/*.cpp)
if(CLANG_FORMAT)
  add_test(NAME due_format COMMAND ${CLANG_FORMAT} --dry-run --Werror ${DUE_ALL})
endif()
if(CLANG_TIDY)
  add_test(NAME due_tidy COMMAND ${CLANG_TIDY} --quiet ${DUE_SOURCES} ${ROSSERIAL_EXTRAS} -- -std=c++11
           -I${CMAKE_CURRENT_SOURCE_DIR}/rosserial/src)
endif()
if(CPPCHECK)
  add_test(NAME due_cppcheck COMMAND ${CPPCHECK} --enable=warning,performance,portability --error-exitcode=1 --quiet
           --std=c++11 -I ${CMAKE_CURRENT_SOURCE_DIR}/rosserial/src ${DUE_SOURCES} ${ROSSERIAL_EXTRAS} ${BOARD_SOURCES})
endif()
