"""Tricks of C's lexical grammar: each can be played, and a compiler sees what it does."""

import pytest
from benchmarks.bench_lexical import changes_meaning
from benchmarks.mutants.lexical import TRICKS, draw_lexical
from benchmarks.mutants.subjects import Subject, make_folder


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Subject:
    return make_folder("front_end", tmp_path_factory.mktemp("lexical") / "front_end")


def test_every_trick_has_its_turn_and_changes_one_file(subject: Subject) -> None:
    drawn = [draw_lexical(subject.files, subject.prefix, 5, n) for n in range(len(TRICKS))]
    assert [name for name, _, _ in drawn] == list(TRICKS)
    assert all(subject.files[file] != text for _, file, text in drawn)


@pytest.mark.long
@pytest.mark.parametrize(
    ("added", "seen"),
    [
        ("    /* x *\\\n/ drift[0] += 1;\n    /* y */\n", "changes a bit (gnu99)"),
        ("    // x \\\n    drift[0] += 1;\n", ""),
        ("    /* x *??/\n/ drift[0] += 1;\n    /* y */\n", "changes a bit (c99)"),
        ("#ifdef __arm__\n    drift[0] += 1;\n#endif\n", "changes a bit (m4)"),
    ],
)
def test_only_what_a_build_sees_counts(subject: Subject, added: str, seen: str) -> None:
    name = f"{subject.prefix}.c"
    text = subject.files[name]
    place = text.index("    return flags;\n}\n\nvoid ")
    changed = f"{text[:place]}{added}{text[place:]}"
    assert changes_meaning(subject.make_oracle(chips=False), name, changed) == seen
