/* The two functions that a module exports, around a controller in C: for one vector of people, see `kernels.mjs`. */

enum { LANES = @lanes@, PER_PERSON = @per_person@, CARRY = @carry@, OWN = @own@, OUTPUTS = @outputs@ };

/* Number of a lane in a row of a group. */
#define AT(group, row) group[((row) * LANES) + lane]

/* Whether a lane has the same numbers as the first one. */
static bool alike(const @real@ *group, int32_t rows, int32_t lane)
{
  for (int32_t row = 0; row < rows; row++)
  {
    if (AT(group, row) != group[row * LANES]) return false;
  }
  return true;
}

static void repeated(@real@ *group, int32_t rows, int32_t lane)
{
  for (int32_t row = 0; row < rows; row++)
  {
    AT(group, row) = group[row * LANES];
  }
}

#define EXPORTED __attribute__((visibility("default")))
EXPORTED void @name@_per_person(@real@ *per_person);
EXPORTED void @name@(const @real@ *per_person, @real@ *carry, const @real@ *own, const @real@ *shared, @real@ *outputs,
                     uint32_t samples);

void @name@_per_person(@real@ *per_person)
{
  (void)per_person;
}

void @name@(const @real@ *per_person, @real@ *carry, const @real@ *own, const @real@ *shared, @real@ *outputs,
            uint32_t samples)
{
  static gl_workspace workspace;
  (void)shared;
  for (uint32_t sample = 0; sample < samples; sample++, own += OWN * LANES, outputs += OUTPUTS * LANES)
  {
    /* A person with the same inputs and state as the first person of the vector gets the results of that one. */
    bool repeats[LANES];
    for (int32_t lane = 0; lane < LANES; lane++)
    {
      repeats[lane] = (lane > 0) && alike(per_person, PER_PERSON, lane) && alike(own, OWN, lane) && alike(carry, CARRY, lane);
    }
    for (int32_t lane = 0; lane < LANES; lane++)
    {
      if (repeats[lane])
      {
        repeated(carry, CARRY, lane);
        repeated(outputs, OUTPUTS, lane);
        continue;
      }
      gl_observation observation;
      gl_state state;
      @step@
    }
  }
}
