"""Machine code for many people, from a JAX function of one: traced, taken apart, and compiled by LLVM."""
