// Environment of the unit tests on the bare board: output by semihosting, no interrupt.
#include <stdint.h>
#include <sys/stat.h>

void uart_interrupt(void) {}

static void write_text(const char* text, uint32_t size) {
  for (uint32_t i = 0; i < size; ++i) {
    char byte[2] = {text[i], 0};
    register uint32_t operation __asm__("r0") = 0x04; /* SYS_WRITE0 */
    register const char* argument __asm__("r1") = byte;
    __asm__ volatile("bkpt 0xAB" : "+r"(operation) : "r"(argument) : "memory");
  }
}

int _write(int file, const char* text, int size) {
  (void)file;
  write_text(text, (uint32_t)size);
  return size;
}

extern char end;
void* _sbrk(int more) {
  static char* top = &end;
  char* before = top;
  top += more;
  return before;
}
int _close(int file) { return file, -1; }
int _fstat(int file, struct stat* about) { return (void)file, about->st_mode = S_IFCHR, 0; }
int _isatty(int file) { return (void)file, 1; }
int _lseek(int file, int offset, int from) { return (void)file, (void)offset, (void)from, 0; }
int _read(int file, char* text, int size) { return (void)file, (void)text, (void)size, 0; }
