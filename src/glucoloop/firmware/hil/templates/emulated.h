/* What an emulated board stores in a file, which lasts when its process ends. */
#ifndef HIL_EMULATED_H
#define HIL_EMULATED_H

#include <stdint.h>

/* Each board writes these four for its way to reach files. */
void file_open(void);
void file_read(uint32_t offset, uint8_t bytes[], uint32_t size);
void file_write(uint32_t offset, const uint8_t bytes[], uint32_t size);
void power_off(void);

/* Open the file, and read in it when the power of this board is to fail. */
void emulated_begin(void);

#endif
