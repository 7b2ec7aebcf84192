"""The C99 runtime, and the host build of a generated model that the tests and `firmware` run."""
