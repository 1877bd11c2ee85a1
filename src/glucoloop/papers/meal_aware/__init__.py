"""The meal-aware controller beside those of Parker, Doyle and Peppas (1999): each claim a number, with its seeds."""
