"""The physical model: effects, their catalogue, and the fit of their parameters to logs."""
