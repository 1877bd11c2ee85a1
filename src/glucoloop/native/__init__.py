"""A JAX function of one person and one sample, lowered to a scalar program and compiled for one of several targets."""
