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
