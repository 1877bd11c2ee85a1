"""The meal-aware controller compared with those of Parker, Doyle and Peppas (1999): numeric claims with their seeds."""
