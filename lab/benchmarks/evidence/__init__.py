"""How often the diagnosis is right on logs of three simulators, and what nobody tuned it to."""
