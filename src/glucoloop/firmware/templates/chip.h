/* What the self-test needs of an emulated chip. */
#ifndef CHIP_H
#define CHIP_H

#include <stdint.h>

void chip_begin(void);
uint32_t chip_instructions(void);
void chip_say(const char *text);

/* A request to the emulator, by ARM semihosting, also on RISC-V. */
int chip_ask(int what, const void *with);

#endif
