"""Stage of zerodrift: hundreds of sensors of one design, each through the whole road."""
