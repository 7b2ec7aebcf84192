"""Every claim of a certificate, derived again from the C by running it over intervals."""
