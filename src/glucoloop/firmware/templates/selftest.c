/* Compares the controller with recorded samples, to the bit, on a computer or on a chip. */
#include "controller.h"
#include "samples.h"

#include <string.h>

#ifdef CHIP
#include "chip.h"
static void say(const char *text)
{
  chip_say(text);
}
#else
#include <stdio.h>
static void say(const char *text)
{
  (void)fputs(text, stdout);
}
#endif

static gl_workspace workspace;
static gl_state state;
static gl_observation observation;
static gl_decision decision;
static uint8_t record[GL_RECORD_SIZE];

static void say_number(uint32_t number)
{
  char text[12];
  uint32_t at = 11U;
  text[at] = '\0';
  do
  {
    at--;
    text[at] = (char)('0' + (char)(number % 10U));
    number /= 10U;
  } while (number != 0U);
  say(&text[at]);
}

int main(void)
{
#ifdef CHIP
  uint32_t max_instructions = 0U;
#endif
  uint32_t wrong = 0U;
  for (uint32_t i = 0U; i < SAMPLES; i++)
  {
    sample_inputs(i, &observation);
    if ((i % RUN) == 0U)
    {
      gl_init(&workspace, &state, &observation);
    }
    (void)memset(&workspace, (int)(i & 0xFFU), sizeof(workspace)); /* nothing in it may last */
#ifdef CHIP
    chip_begin();
#endif
    gl_step(&workspace, &state, &observation, &decision);
#ifdef CHIP
    {
      const uint32_t instructions = chip_instructions();
      max_instructions = (instructions > max_instructions) ? instructions : max_instructions;
    }
#endif
    if (!sample_matches(i, &decision))
    {
      wrong++;
      say("sample ");
      say_number(i);
      say(" differs\n");
    }
    gl_save(&state, record); /* a loss of power at every sample */
    (void)memset(&state, 0xFF, sizeof(state));
    if (!gl_restore(&state, record))
    {
      wrong++;
      say("a saved state was refused\n");
    }
    record[20] ^= 1U;
    if (gl_restore(&state, record))
    {
      wrong++;
      say("a damaged state was accepted\n");
    }
  }
  (void)memset(&state, 0xFF, sizeof(state)); /* a state of which nothing is a number */
  gl_step(&workspace, &state, &observation, &decision);
  if (!((decision.insulin_mU_min >= MIN_RATE) && (decision.insulin_mU_min <= MAX_RATE)))
  {
    wrong++;
    say("a dose out of the limits\n");
  }
  say((wrong == 0U) ? "passed, every dose and status equal to the bit: samples=" : "FAILED: samples=");
  say_number(SAMPLES);
  say(" wrong=");
  say_number(wrong);
#ifdef CHIP
  say(" instructions=");
  say_number(max_instructions);
#endif
  say(" state=");
  say_number((uint32_t)sizeof(state));
  say(" bytes workspace=");
  say_number((uint32_t)sizeof(workspace));
  say(" bytes\n");
  return (wrong == 0U) ? 0 : 1;
}
