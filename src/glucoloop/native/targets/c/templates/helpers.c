/* The bits of a number. */
static @bits@ gl_bits(@real@ x)
{
  @bits@ b;
  (void)memcpy((uint8_t *)&b, (const uint8_t *)&x, sizeof(b));
  return b;
}

/* The number that has these bits. */
static @real@ gl_number(@bits@ b)
{
  @real@ x;
  (void)memcpy((uint8_t *)&x, (const uint8_t *)&b, sizeof(x));
  return x;
}

/* The absolute value. */
static @real@ gl_abs(@real@ x)
{
  return (x > 0x0p+0@f@) ? x : (0x0p+0@f@ - x);
}

/* Whether x is a finite number. */
static bool gl_finite(@real@ x)
{
  return (x >= -@MAX@) && (x <= @MAX@);
}

/* The larger of two numbers; NaN if either is NaN. */
static @real@ gl_max(@real@ a, @real@ b)
{
  return (a != a) ? a : ((a > b) ? a : b);
}

/* The smaller of two numbers; NaN if either is NaN. */
static @real@ gl_min(@real@ a, @real@ b)
{
  return (a != a) ? a : ((a < b) ? a : b);
}

/* Whether low <= x <= high. */
static bool gl_inside(@real@ x, @real@ low, @real@ high)
{
  return (x >= low) && (x <= high);
}

/* x limited to low <= x <= high; NaN if any of them is NaN. */
static @real@ gl_clip(@real@ x, @real@ low, @real@ high)
{
  return gl_min(high, gl_max(low, x));
}

/* x with the sign of y. */
static @real@ gl_copy_sign(@real@ x, @real@ y)
{
  const @bits@ sign = (@bits@)1@u@ << @signbit@;
  return gl_number((gl_bits(x) & ~sign) | (gl_bits(y) & sign));
}

/* The largest whole number that is not above x. */
static @real@ gl_floor(@real@ x)
{
  @real@ r = x;
  if (gl_abs(x) < @magic@)
  {
    r = gl_copy_sign((gl_abs(x) + @magic@) - @magic@, x);
    r = (r > x) ? (r - 0x1p+0@f@) : r;
  }
  return r;
}

/* x = mantissa 2^exponent with a mantissa in [1, 2), for a normal x above 0. */
static @real@ gl_mantissa(@real@ x)
{
  const @bits@ mantissa = gl_bits(x) & ((((@bits@)1@u@) << @shift@) - 1@u@);
  return gl_number(mantissa | ((@bits@)@bias@@u@ << @shift@));
}

static @real@ gl_exponent(@real@ x)
{
  const @bits@ b = (gl_bits(x) >> @shift@) & (@bits@)@mask@@u@;
  const int32_t e = (int32_t)b - (int32_t)@bias@;
  return (@real@)e;
}

/* Two to the whole number that stands in the last bits of x. */
static @real@ gl_power_of_two(@real@ x)
{
  return gl_number((@bits@)((@bits@)(gl_bits(x) << @shift@) + ((@bits@)@bias@@u@ << @shift@)));
}

static @real@ gl_square(@real@ x)
{
  return x * x;
}

/* x to a whole power from 1 on. */
static @real@ gl_power(@real@ x, int32_t n)
{
  @real@ product = x;
  for (int32_t i = 1; i < n; i++)
  {
    product = product * x;
  }
  return product;
}

/* 1, -1, or x itself if it is zero or NaN. */
static @real@ gl_sign(@real@ x)
{
  return (x > 0x0p+0@f@) ? 0x1p+0@f@ : ((x < 0x0p+0@f@) ? (-0x1p+0@f@) : x);
}

/* Whether a sorts before b; NaN sorts last. */
static bool gl_below(@real@ a, @real@ b)
{
  return (a < b) || ((a == a) && (b != b));
}

/* The whole number next to x towards zero, within 2^30; zero for NaN. */
static int32_t gl_whole(@real@ x)
{
  int32_t n = 0;
  if (x == x)
  {
    const @real@ low = (x > (-0x1p+30@f@)) ? x : (-0x1p+30@f@);
    n = (int32_t)((low < 0x1p+30@f@) ? low : 0x1p+30@f@);
  }
  return n;
}

static int32_t gl_whole_max(int32_t a, int32_t b)
{
  return (a > b) ? a : b;
}

static int32_t gl_whole_min(int32_t a, int32_t b)
{
  return (a < b) ? a : b;
}

static int32_t gl_whole_abs(int32_t a)
{
  return (a < 0) ? -a : a;
}

/* The quotient, towards zero; -1 where b is zero. */
static int32_t gl_whole_div(int32_t a, int32_t b)
{
  return (b == 0) ? -1 : (a / b);
}

/* The remainder; a where b is zero. */
static int32_t gl_whole_rem(int32_t a, int32_t b)
{
  return (b == 0) ? a : (a % b);
}

/* A place from 0 to the last one. */
static int32_t gl_within(int32_t place, int32_t last)
{
  return (place < 0) ? 0 : ((place > last) ? last : place);
}

/* Factors of an n by n matrix in its place, with row exchanges. */
static void gl_lu(int32_t n, @real@ a[], int32_t order[])
{
  for (int32_t i = 0; i < n; i++)
  {
    order[i] = i;
  }
  for (int32_t k = 0; k < n; k++)
  {
    int32_t best = k;
    for (int32_t i = k + 1; i < n; i++)
    {
      best = (gl_abs(a[(n * i) + k]) > gl_abs(a[(n * best) + k])) ? i : best;
    }
    if (best != k)
    {
      const int32_t other = order[k];
      order[k] = order[best];
      order[best] = other;
      for (int32_t j = 0; j < n; j++)
      {
        const @real@ element = a[(n * k) + j];
        a[(n * k) + j] = a[(n * best) + j];
        a[(n * best) + j] = element;
      }
    }
    for (int32_t i = k + 1; i < n; i++)
    {
      const @real@ factor = a[(n * i) + k] / a[(n * k) + k];
      a[(n * i) + k] = factor;
      for (int32_t j = k + 1; j < n; j++)
      {
        a[(n * i) + j] = a[(n * i) + j] - (factor * a[(n * k) + j]);
      }
    }
  }
}

/* Product of an n by count and a count by m matrix; of the second one each row lies in one piece. The last columns may
   be computed twice. */
static void gl_product(int32_t n, int32_t m, int32_t count, const @real@ a[], int32_t a_row, int32_t a_column,
                       const @real@ b[], int32_t b_row, @real@ to[], int32_t to_row, int32_t to_column)
{
  for (int32_t i = 0; i < n; i++)
  {
    for (int32_t next = 0; next < m; next += @COLUMNS@)
    {
      const int32_t j = (next > (m - @COLUMNS@)) ? (m - @COLUMNS@) : next;
      @each@ @real@ c# = 0x0p+0@f@;
      for (int32_t k = 0; k < count; k++)
      {
        const @real@ x = a[(a_row * i) + (a_column * k)];
        @each@ c# = c# + (x * b[(b_row * k) + j + #]);
      }
      @each@ to[(to_row * i) + (to_column * (j + #))] = c#;
    }
  }
}

/* Solution x of a x = b for a lower triangular n by n matrix and m columns, whose rows lie in one piece. The last
   columns may be computed twice. */
static void gl_solve(int32_t n, int32_t m, const @real@ a[], int32_t a_row, int32_t a_column, bool unit,
                     const @real@ b[], @real@ x[], int32_t row)
{
  for (int32_t i = 0; i < n; i++)
  {
    for (int32_t next = 0; next < m; next += @COLUMNS@)
    {
      const int32_t j = (next > (m - @COLUMNS@)) ? (m - @COLUMNS@) : next;
      @each@ @real@ c# = b[(row * i) + j + #];
      for (int32_t k = 0; k < i; k++)
      {
        const @real@ y = a[(a_row * i) + (a_column * k)];
        @each@ c# = c# - (y * x[(row * k) + j + #]);
      }
      if (!unit)
      {
        const @real@ pivot = a[(a_row * i) + (a_column * i)];
        @each@ c# = c# / pivot;
      }
      @each@ x[(row * i) + j + #] = c#;
    }
  }
}

/* The square root, rounded to nearest, digit by digit. */
static @real@ gl_sqrt(@real@ x)
{
  @real@ root = x; /* of zero, infinity and NaN */
  if (x < 0x0p+0@f@)
  {
    root = NAN;
  }
  else if ((x > 0x0p+0@f@) && (x <= @MAX@))
  {
    @bits@ b = gl_bits(x);
    int32_t e = (int32_t)(b >> @shift@);
    b &= ((@bits@)1@u@ << @shift@) - 1@u@;
    if (e == 0) /* subnormal */
    {
      int32_t zeros = 0;
      while ((zeros < @shift@) && ((b >> @shift@) == 0@u@))
      {
        b <<= 1;
        zeros += 1;
      }
      e = 1 - zeros;
    }
    else
    {
      b |= (@bits@)1@u@ << @shift@;
    }
    e -= @bias@;
    if ((e % 2) != 0)
    {
      b <<= 1;
      e -= 1;
    }
    b <<= 1;
    {
      @bits@ sum = 0@u@;
      @bits@ digits = 0@u@;
      @bits@ digit = (@bits@)2@u@ << @shift@;
      while (digit != 0@u@)
      {
        const @bits@ trial = sum + digit;
        if (trial <= b)
        {
          sum = trial + digit;
          b -= trial;
          digits += digit;
        }
        b <<= 1;
        digit >>= 1;
      }
      digits += (b != 0@u@) ? (digits & 1@u@) : 0@u@;
      digits = (digits >> 1) + (((@bits@)@bias@@u@ - 1@u@) << @shift@);
      if (e >= 0)
      {
        digits += ((@bits@)e / 2@u@) << @shift@;
      }
      else
      {
        digits -= ((@bits@)(-e) / 2@u@) << @shift@;
      }
      root = gl_number(digits);
    }
  }
  else
  {
    /* x is its own root */
  }
  return root;
}
