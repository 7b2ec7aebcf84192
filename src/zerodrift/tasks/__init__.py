"""One module per use case: a request in, a frozen result out; no click, no print."""
