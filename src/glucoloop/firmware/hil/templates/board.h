/* What the firmware needs of a board. Write these functions for yours. */
#ifndef HIL_BOARD_H
#define HIL_BOARD_H

#include <stdint.h>

/* Prepare the serial port and the non-volatile memory, and start a watchdog that resets the chip unless it is fed. */
void board_begin(uint32_t watchdog_ms);

/* Feed the watchdog. */
void board_feed(void);

/* Wait for received bytes for a while that is short against the watchdog's; return their number, 0 if none came. */
uint32_t board_receive(uint8_t bytes[], uint32_t most);

/* Send bytes; return when they are on their way. */
void board_send(const uint8_t bytes[], uint32_t size);

/* Read non-volatile memory; bytes that were never written may be anything. */
void board_nvm_read(uint32_t offset, uint8_t bytes[], uint32_t size);

/* Write non-volatile memory, and return when the bytes would survive a loss of power. */
void board_nvm_write(uint32_t offset, const uint8_t bytes[], uint32_t size);

#endif
