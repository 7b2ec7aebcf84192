"""Other inference libraries for microcontrollers beside zerodrift: the same GRU and LSTM."""
