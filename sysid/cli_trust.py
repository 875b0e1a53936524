"""Commands that say how far a fit can be trusted, before it and after it."""
