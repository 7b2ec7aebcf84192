"""`verify` derives the certificate again: C that gives every bit and leaves its arrays fails."""

import hashlib
import json
from pathlib import Path

import pytest
from benchmarks.mutants.judge import identify_files, replace_file

from zerodrift.verify.replay import (
    CERTIFICATE,
    FolderCertificate,
    check_folder_certificate,
)

pytestmark = pytest.mark.long


def derive(project: Path) -> FolderCertificate:
    """Return what becomes of a project's certificate beside the runtime of its own folder."""
    folder = project / "firmware"
    runtime = {path.name: path.read_text() for path in folder.glob("zd_*.[ch]")}
    return check_folder_certificate(folder, runtime)


def replace_text(project: Path, name: str, before: str, after: str) -> None:
    """Change the C, its identities and every hash that speaks of it, as another version would."""
    firmware = project / "firmware"
    texts = {p.name: p.read_text() for p in firmware.iterdir() if p.suffix in (".c", ".h")}
    assert before in texts[name]
    prefix = json.loads((firmware / "certificate.json").read_text())["prefix"]
    changed = identify_files({**texts, name: texts[name].replace(before, after, 1)}, prefix)
    for file, text in changed.items():
        if text != texts[file]:
            replace_file(firmware / file, text.encode(), [firmware, project / "build"])


def test_a_sound_certificate_is_counted_and_may_be_required(project: Path, zerodrift) -> None:
    claims = json.loads((project / "firmware/certificate.json").read_text())
    done = zerodrift("verify", "-C", project, "--require", "certificate", "--json")
    told = json.loads(done.out)
    assert done.code == 0, done.err
    assert told["claims"] >= len(claims["bounds"]) and told["refuted"] == []
    assert all(one["what"] != CERTIFICATE for one in told["not_checked"])


def test_a_scratch_array_that_is_too_short_is_found(project: Path) -> None:
    short = "int32_t v[-1 + ZD_PAIR_SCRATCH("
    replace_text(project, "front_end.c", "int32_t v[ZD_PAIR_SCRATCH(", short)
    found = derive(project)
    assert any("ZD_KERNEL_PAIRS" in text and "of v from" in text for text in found.failures)


def test_a_claim_that_is_too_narrow_fails_though_no_bit_differs(project: Path, zerodrift) -> None:
    path = project / "firmware" / "certificate.json"
    claims = json.loads(path.read_text())
    bound = next(b for b in claims["bounds"] if b["high"] > 1)
    bound["high"] -= 1
    replace_file(path, json.dumps(claims).encode(), [project / "firmware", project / "build"])
    done = zerodrift("verify", "-C", project, "--trust")
    assert done.code == 1
    assert "the certificate does not follow from the C" in done.err and bound["where"] in done.err


def test_without_a_certificate_it_is_not_checked(project: Path, zerodrift) -> None:
    (project / "firmware/certificate.json").unlink()
    found = derive(project)
    assert (found.holds, found.failures) == (0, ())
    assert [one.what for one in found.not_checked] == [CERTIFICATE]
    done = zerodrift("verify", "-C", project, "--require", "certificate")
    assert done.code == 1 and "certificate: is required and was not checked" in done.err


def test_another_runtime_has_no_rules(project: Path) -> None:
    path = project / "firmware/zd_runtime.c"
    before = hashlib.sha256(path.read_bytes()).hexdigest()
    path.write_text(path.read_text() + "/* of another version */\n")
    certificate = project / "firmware/certificate.json"
    after = hashlib.sha256(path.read_bytes()).hexdigest()
    certificate.write_text(certificate.read_text().replace(before, after))
    found = derive(project)
    assert not found.failures and "another version" in found.not_checked[0].why


def test_a_statement_hidden_in_a_comment_is_refused_with_its_place(project: Path) -> None:
    step = "    uint32_t flags = 0;\n    const int32_t in_0"
    hidden = "    (void)'/*';\n    s->steps = 0u;\n    /* done */\n"
    replace_text(project, "front_end.c", step, hidden + step)
    (told,) = (text for text in derive(project).failures if "a comment" in text)
    assert told.startswith("certificate.json: front_end.c:")
