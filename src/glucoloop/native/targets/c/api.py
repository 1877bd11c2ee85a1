"""Common parts of exported controllers beside their two functions: the header, and saved states."""

from __future__ import annotations

from typing import Final

MEANINGS: Final = {
    "observation": {
        "glucose_mg_dl": "reading of the sensor [mg/dl]; any bits where it is not valid",
        "valid": "0: the sensor has no valid reading, otherwise: it has",
        "setpoint_mg_dl": "glucose that is to be reached [mg/dl]",
        "delivered_mU_min": "rate that the pump delivered since the last step [mU/min]",
        "announced_carbs_g": "carbohydrate of a meal that begins before the next step [g]; 0: none, or none is told",
        "delivered_bolus_mU": "bolus that the pump delivered since the last step, apart from that rate [mU]; 0: none",
        "time_of_day_min": "minutes after midnight, from 0 to below 1440 [min]",
    },
    "decision": {
        "insulin_mU_min": "rate until the next step [mU/min]",
        "bolus_mU": "insulin to be given at once, beside that rate [mU]; 0: none",
        "status": "why: one of the numbers of a status, 0 where all is well",
    },
}
"""Meanings of the fields of an observation and of a decision."""
_PROTOTYPES: Final = """
/* Wake the controller at an observation; the first step may be given the same observation. */
void gl_init(gl_workspace *workspace, gl_state *state, const gl_observation *observation);

/* Decide on the dose until the next sample. It cannot fail, whatever it is given. */
void gl_step(gl_workspace *workspace, gl_state *state, const gl_observation *observation,
             gl_decision *decision);

/* Write the state to a record that survives a loss of power. */
void gl_save(const gl_state *state, uint8_t record[GL_RECORD_SIZE]);

/* Read a state back; false if the record is damaged or of another design, and the state is as it was. */
bool gl_restore(gl_state *state, const uint8_t record[GL_RECORD_SIZE]);

#endif
"""

_SAVING: Final = """
/* The mark GLST, and the first 12 bytes of the digest of the design. */
static const uint8_t gl_mark[16] = {@MARK@};

/* No gap may hide in the state: it is saved as it stands in memory. */
typedef char gl_state_has_no_gaps[(sizeof(gl_state) == @SIZE@U) ? 1 : -1];

/* CRC-32 as of IEEE 802.3. */
static uint32_t gl_crc(const uint8_t bytes[], uint32_t size)
{
  uint32_t crc = 0xFFFFFFFFU;
  for (uint32_t i = 0U; i < size; i++)
  {
    crc ^= bytes[i];
    for (uint32_t bit = 0U; bit < 8U; bit++)
    {
      crc = (crc >> 1) ^ (((crc & 1U) != 0U) ? 0xEDB88320U : 0U);
    }
  }
  return ~crc;
}

void gl_save(const gl_state *state, uint8_t record[GL_RECORD_SIZE])
{
  uint32_t crc;
  (void)memcpy(&record[0], &gl_mark[0], sizeof(gl_mark));
  (void)memcpy(&record[16], (const uint8_t *)state, sizeof(gl_state));
  crc = gl_crc(&record[0], GL_RECORD_SIZE - 4U);
  (void)memcpy(&record[GL_RECORD_SIZE - 4U], (const uint8_t *)&crc, sizeof(crc));
}

bool gl_restore(gl_state *state, const uint8_t record[GL_RECORD_SIZE])
{
  uint32_t crc;
  bool whole;
  (void)memcpy((uint8_t *)&crc, &record[GL_RECORD_SIZE - 4U], sizeof(crc));
  whole = (crc == gl_crc(&record[0], GL_RECORD_SIZE - 4U)) && (memcmp(&record[0], &gl_mark[0], sizeof(gl_mark)) == 0);
  if (whole)
  {
    (void)memcpy((uint8_t *)state, &record[16], sizeof(gl_state));
  }
  return whole;
}
"""
_AROUND: Final = 20
"""Number of bytes of a record around the state: mark, digest and CRC."""


def record_bytes(state_bytes: int) -> int:
    """Number of bytes of a saved state."""
    return state_bytes + _AROUND


def header(structures: str, state_bytes: int) -> str:
    """The header around the structures."""
    return "\n".join(
        [
            "#ifndef GL_CONTROLLER_H",
            "#define GL_CONTROLLER_H",
            "",
            "#include <stdbool.h>",
            "#include <stdint.h>",
            "",
            structures,
            "",
            "/* Size of a saved state, in bytes: a mark, the digest of the design, the state, and a CRC-32. */",
            f"#define GL_RECORD_SIZE {record_bytes(state_bytes)}U",
            _PROTOTYPES,
        ]
    )


def saving(state_bytes: int, design: str) -> str:
    """``gl_save`` and ``gl_restore``, for a design with a digest."""
    mark = ["47", "4C", "53", "54", *(design[i : i + 2].upper() for i in range(0, 24, 2))]
    text = _SAVING.replace("@MARK@", ", ".join(f"0x{byte}U" for byte in mark))
    return text.replace("@SIZE@", str(state_bytes))
