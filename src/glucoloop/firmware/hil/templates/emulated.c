/* Non-volatile memory of an emulated board, whose power fails, or whose program hangs, amid a record. */
#include "emulated.h"

#include "board.h"
#include "frame.h"
#include "link.h"

static uint32_t failure; /* what is to happen, once `left` bytes more have been written */
static uint32_t left;

void emulated_begin(void)
{
  uint8_t plan[8];
  file_read(HIL_PLAN_AT, plan, (uint32_t)sizeof(plan));
  failure = hil_get32(&plan[0]);
  left = hil_get32(&plan[4]);
  if (failure != HIL_PLAN_NONE)
  {
    hil_put32(&plan[0], HIL_PLAN_NONE);
    file_write(HIL_PLAN_AT, plan, 4U); /* it happens once */
  }
}

void board_nvm_read(uint32_t offset, uint8_t bytes[], uint32_t size)
{
  file_read(offset, bytes, size);
}

void board_nvm_write(uint32_t offset, const uint8_t bytes[], uint32_t size)
{
  const uint32_t now = ((failure != HIL_PLAN_NONE) && (left < size)) ? left : size;
  file_write(offset, bytes, now);
  if (failure != HIL_PLAN_NONE)
  {
    left -= now;
    if (left == 0U)
    {
      if (failure == HIL_PLAN_CUT)
      {
        power_fails();
      }
      for (;;)
      {
        /* The program hangs, and the watchdog is not fed. */
      }
    }
  }
}
