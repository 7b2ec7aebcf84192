"""From the integer model to C text: returns strings, writes nothing; the commands write."""
