/* Two records in non-volatile memory: see store.h, and the guide of `glucoloop hil` for their layout. */
#include "store.h"

#include "board.h"
#include "frame.h"

#include <string.h>

#define DECISION_AT 20U
#define STATE_AT (DECISION_AT + (uint32_t)sizeof(gl_decision))
#define CRC_AT (STATE_AT + GL_RECORD_SIZE)
#define RECORD_SIZE (CRC_AT + 4U)

typedef char hil_record_fits_its_place[(RECORD_SIZE <= HIL_PLACE) ? 1 : -1];

static uint8_t record[RECORD_SIZE];

static bool read_place(uint32_t place, hil_memory *memory)
{
  bool whole;
  board_nvm_read(place * HIL_PLACE, record, RECORD_SIZE);
  whole = (hil_get32(&record[0]) == HIL_RECORD_MARK) && (hil_get32(&record[CRC_AT]) == hil_crc(record, CRC_AT)) &&
          gl_restore(&memory->state, &record[STATE_AT]);
  if (whole)
  {
    memory->sequence = hil_get32(&record[4]);
    memory->session = hil_get32(&record[8]);
    memory->next = hil_get32(&record[12]);
    memory->answered = hil_get32(&record[16]);
    (void)memcpy((uint8_t *)&memory->decision, &record[DECISION_AT], sizeof(gl_decision));
  }
  return whole;
}

bool hil_load(hil_memory *memory)
{
  static hil_memory other;
  bool found;
  (void)memset(memory, 0, sizeof(*memory));
  (void)memset(&other, 0, sizeof(other));
  found = read_place(0U, memory);
  if (read_place(1U, &other) && ((!found) || (other.sequence > memory->sequence)))
  {
    *memory = other;
    found = true;
  }
  return found;
}

void hil_keep(hil_memory *memory)
{
  memory->sequence++;
  hil_put32(&record[0], HIL_RECORD_MARK);
  hil_put32(&record[4], memory->sequence);
  hil_put32(&record[8], memory->session);
  hil_put32(&record[12], memory->next);
  hil_put32(&record[16], memory->answered);
  (void)memcpy(&record[DECISION_AT], (const uint8_t *)&memory->decision, sizeof(gl_decision));
  gl_save(&memory->state, &record[STATE_AT]);
  hil_put32(&record[CRC_AT], hil_crc(record, CRC_AT));
  board_nvm_write((memory->sequence & 1U) * HIL_PLACE, record, RECORD_SIZE);
}
