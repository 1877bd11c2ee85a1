/* Recorded samples: observations of a closed loop with faults, and absurd ones at the end. */
#include "controller.h"

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#define SAMPLES @SAMPLES@U
#define RUN @RUN@U /* samples after which the controller is woken anew */
#define LEAST @LEAST@
#define MOST @MOST@

/* The bits of: @GIVEN_NAMES@. */
static const @BITS@ given[SAMPLES][@GIVEN@] = {
@GIVEN_ROWS@
};

/* The bits of: @EXPECTED_NAMES@. */
static const @BITS@ expected[SAMPLES][@EXPECTED@] = {
@EXPECTED_ROWS@
};

static void samples_given(uint32_t i, gl_observation *to)
{
@READ@
}

static bool samples_expected(uint32_t i, const gl_decision *of)
{
  bool equal = true;
  @BITS@ bits;
@COMPARED@
  return equal;
}
