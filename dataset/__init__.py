"""Stage of zerodrift."""
