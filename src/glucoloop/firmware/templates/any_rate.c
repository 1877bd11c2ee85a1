#include "__fc_builtin.h"
#include <float.h>
#include <stdbool.h>
@FUNCTION@
int main(void)
{
  const @REAL@ rate = Frama_C_@REAL@_interval(-@MAX@, @MAX@);
  /*@ loop unroll @SLICES@; */
  for (int i = 0; i < @SLICES@; i++)
  {
    const @REAL@ low = @LEAST@ + ((@REAL@)i * @WIDTH@);
    const @REAL@ high = @LEAST@ + ((@REAL@)(i + 1) * @WIDTH@);
    const @REAL@ delivered = Frama_C_@REAL@_interval(low, (high > @MOST@) ? @MOST@ : high);
    const double change = (double)gl_limited(rate, delivered) - (double)delivered;
    /*@ assert change: -@BOUND@ <= change <= @BOUND@; */
  }
  return 0;
}
