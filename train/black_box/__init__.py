"""How much of a model's residual can be learnt: a lag bank and a GRU that see every signal."""
