"""Patient family of Sorensen (1985): nineteen states, intravenous insulin, arterial glucose."""
