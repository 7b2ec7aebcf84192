"""Real records, each fifth predicted from the others: which, how they are cut, and by what."""
