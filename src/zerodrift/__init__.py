"""zerodrift: temperature logs in, bit-exact fixed-point drift-compensation firmware out."""

__version__ = "0.1.0"
