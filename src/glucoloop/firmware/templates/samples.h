/* Recorded samples: observations of a closed loop with faults, and absurd ones at the end. */
#include "controller.h"

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#define SAMPLES @SAMPLES@U
#define RUN @RUN@U /* samples after which the controller is initialised again */
#define MIN_RATE @MIN_RATE@
#define MAX_RATE @MAX_RATE@

/* The bits of: @INPUT_NAMES@. */
static const @BITS@ inputs[SAMPLES][@INPUTS@] = {
@INPUT_ROWS@
};

/* The bits of: @EXPECTED_NAMES@. */
static const @BITS@ expected[SAMPLES][@EXPECTED@] = {
@EXPECTED_ROWS@
};

static void sample_inputs(uint32_t i, gl_observation *to)
{
@READ@
}

static bool sample_matches(uint32_t i, const gl_decision *of)
{
  bool equal = true;
  @BITS@ bits;
@COMPARED@
  return equal;
}
