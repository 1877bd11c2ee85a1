/* What the self-test needs of an emulated chip. */
#ifndef CHIP_H
#define CHIP_H

#include <stdint.h>

void chip_begin(void);
uint32_t chip_instructions(void);
void chip_say(const char *text);

#endif
