"""The lag bank: first-order lags of every thermometer, powers of them, and a few tanh units."""
