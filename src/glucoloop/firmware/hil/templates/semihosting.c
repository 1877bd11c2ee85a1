/* Files of an emulated chip: QEMU opens them on this computer by ARM semihosting, also for RISC-V. */
#include "chip.h"
#include "emulated.h"

#include <stddef.h>

#define OPEN 0x01
#define CLOSE 0x02
#define WRITE 0x05
#define READ 0x06
#define SEEK 0x0A
#define EXIT 0x20

static void check(int answer)
{
  if (answer != 0)
  {
    const uintptr_t with[2] = {0x20026U, 4U};
    (void)chip_ask(EXIT, with);
  }
}

/* It is opened each time: after a reset nobody would know which one was open. */
static uintptr_t opened_at(uint32_t offset)
{
  static const char name[] = "nvm.bin";
  const uintptr_t with[3] = {(uintptr_t)name, 3U, sizeof(name) - 1U}; /* 3: "r+b" */
  const int opened = chip_ask(OPEN, with);
  const uintptr_t place[2] = {(uintptr_t)opened, offset};
  check((opened < 0) ? 1 : 0);
  check(chip_ask(SEEK, place));
  return place[0];
}

void file_read(uint32_t offset, uint8_t bytes[], uint32_t size)
{
  const uintptr_t with[3] = {opened_at(offset), (uintptr_t)bytes, size};
  check(chip_ask(READ, with));
  check(chip_ask(CLOSE, with));
}

void file_write(uint32_t offset, const uint8_t bytes[], uint32_t size)
{
  const uintptr_t with[3] = {opened_at(offset), (uintptr_t)bytes, size};
  check(chip_ask(WRITE, with));
  check(chip_ask(CLOSE, with));
}
