"""Stage of zerodrift: what comes after the flashing - units in use, watched and written down."""
