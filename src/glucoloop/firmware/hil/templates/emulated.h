/* What an emulated board stores in a file, which lasts when its power fails. */
#ifndef HIL_EMULATED_H
#define HIL_EMULATED_H

#include <stdint.h>

/* Each board writes these three for its way to reach files, and to be started again. */
void file_read(uint32_t offset, uint8_t bytes[], uint32_t size);
void file_write(uint32_t offset, const uint8_t bytes[], uint32_t size);
void power_fails(void);

/* Read in the file when the power of this board is to fail; that is then said no more. */
void emulated_begin(void);

#endif
