"""The paper's experiments on the twin: `zerodrift paper`, and the benchmark built of its parts."""
