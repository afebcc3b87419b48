// The part of the Due's Arduino core that src/board/ uses, on a board without hardware; pins.h is the test's side.
#pragma once

#include <stddef.h>
#include <stdint.h>

#define LOW 0
#define HIGH 1
#define INPUT_PULLUP 2
#define OUTPUT 1
#define CHANGE 2

const uint8_t A2 = 56;

struct Rstc {  // why the processor started, as the SAM3X reports it
  uint32_t RSTC_SR;
};
extern Rstc the_reset_controller;
#define RSTC (&the_reset_controller)
#define RSTC_SR_RSTTYP_Pos 8
#define RSTC_SR_RSTTYP_Msk (0x7u << RSTC_SR_RSTTYP_Pos)

void pinMode(uint32_t pin, uint32_t mode);
void digitalWrite(uint32_t pin, uint32_t level);
int digitalRead(uint32_t pin);
void analogWrite(uint32_t pin, uint32_t duty);
void analogWriteResolution(int bits);
void analogReadResolution(int bits);
uint32_t analogRead(uint32_t pin);
uint32_t digitalPinToInterrupt(uint32_t pin);
void attachInterrupt(uint32_t pin, void (*callback)(), uint32_t mode);
void noInterrupts();
void interrupts();
void delay(uint32_t ms);
uint32_t millis();
uint32_t micros();
void watchdogEnable(uint32_t ms);
void watchdogReset();

class SerialPort {
 public:
  void begin(uint32_t baud);
  int available();
  int read();
  int availableForWrite();
  size_t write(const uint8_t* data, size_t size);
};

extern SerialPort Serial1;
