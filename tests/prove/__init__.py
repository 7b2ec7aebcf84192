"""The proof that C equals specification, and what must never pass it."""
