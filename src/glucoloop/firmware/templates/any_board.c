/* A board whose line and whose memory give any bytes. */
#include "board.h"
@ANYTHING@
extern volatile uint32_t any_number;
void board_begin(uint32_t watchdog_ms) { (void)watchdog_ms; }
void board_feed(void) {}
uint32_t board_receive(uint8_t bytes[], uint32_t most)
{
  const uint32_t count = any_number;
  anything(bytes, most);
  return (count <= most) ? count : most;
}
/*@ requires \valid_read(bytes + (0 .. size - 1)); assigns \nothing; */
void board_send(const uint8_t bytes[], uint32_t size);
void board_nvm_read(uint32_t offset, uint8_t bytes[], uint32_t size)
{
  (void)offset;
  anything(bytes, size);
}
/*@ requires \valid_read(bytes + (0 .. size - 1)); assigns \nothing; */
void board_nvm_write(uint32_t offset, const uint8_t bytes[], uint32_t size);
