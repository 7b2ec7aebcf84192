"""What the proof calls things in C is what the generator calls them, for drawn names."""

import random

from zerodrift.codegen import identifiers
from zerodrift_proof.equality import model

WORDS = [
    *sorted(identifiers._KEYWORDS),
    *("stdio", "math", "time", "atomic", "sem", "zd", "zd_x", "6 axis", "INT", "int_x", " a  b"),
    *(
        "é",
        "",
        "x" * 40,
        "max",
        "h",
        "flag_a",
        "format",
        "INT8 max",
        "lsb_per_unit",
        "a_lsb_per_unit",
    ),
]
PREFIXES = ("int8", "flt", "ft40", "sensor", "seek", "m", "clocks")


def test_names_are_the_generator_s() -> None:
    rng = random.Random(5)
    for _ in range(5000):
        drawn = "".join(rng.choice("aB_9 z-") for _ in range(rng.randint(0, 36)))
        texts = [rng.choice((rng.choice(WORDS), drawn)) for _ in range(3)]
        prefix = rng.choice(PREFIXES)
        assert model.sanitize_names(texts, "input") == identifiers.sanitize_identifiers(
            texts, "input"
        )
        assert model.sanitize_outputs(texts, prefix) == identifiers.sanitize_outputs(texts, prefix)
        assert model.sanitize_prefix(texts[0]) == identifiers.sanitize_prefix(texts[0])
