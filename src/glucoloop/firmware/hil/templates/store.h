/* What the chip must not forget when power fails: two records in non-volatile memory, written in turn. */
#ifndef HIL_STORE_H
#define HIL_STORE_H

#include "controller.h"
#include "link.h"

#include <stdbool.h>
#include <stdint.h>

typedef struct
{
  uint32_t sequence; /* number of the record, up by one with each that is written; 0: none was */
  uint32_t session;  /* 0: none has begun */
  uint32_t next;     /* number of the next sample of the session */
  uint32_t answered; /* 1 if the session has answered a sample, so that state and decision are of next - 1 */
  gl_state state;
  gl_decision decision; /* of the sample next - 1 */
} hil_memory;

/* Read the newest record that is whole and of this design; false if there is none, and the memory is all zeros. */
bool hil_load(hil_memory *memory);

/* Write the memory to the older of the two places. It counts when the last byte is written. */
void hil_keep(hil_memory *memory);

#endif
