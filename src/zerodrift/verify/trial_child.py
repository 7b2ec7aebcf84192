"""Runs a host build in a process of its own; started by `trial.py` as a script, without a package.

Over every stretch of codes, from settle or init; then, if it is asked to, over states of which one
byte or word is another, and random ones: two steps each, a copy of it saved and restored. What is
being done is printed before it is done, and a checksum of the answers after it.
"""

import ctypes
import json
import random
import sys
import zlib
from pathlib import Path

SPARE = 4096
"""Bytes behind every buffer, which have to stay as they are."""
FILL = 0xA5
MOST_PLACES = 1024
"""Bytes of a state, spread over it, that are changed; words likewise."""
RANDOM_STATES = 200
WORDS = (0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0, 0x00010001)
STEPS = 24


class Buffer:
    """Bytes with a margin that nobody may write to."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.bytes = ctypes.create_string_buffer(bytes([FILL]) * (size + SPARE), size + SPARE)

    def put(self, content: bytes) -> None:
        """Overwrite the beginning."""
        ctypes.memmove(self.bytes, content, min(len(content), self.size))

    def take(self) -> bytes:
        """Return what is in it."""
        return self.bytes.raw[: self.size]

    def is_intact(self) -> bool:
        """Tell whether the margin is as it was."""
        return self.bytes.raw[self.size :] == bytes([FILL]) * SPARE


class Library:
    """A host build, its state, and the checksum of its answers."""

    def __init__(self, job: dict[str, object]) -> None:
        lib = ctypes.CDLL(str(job["library"]))
        self.outputs, self.values = int(str(job["outputs"])), int(str(job["values"]))
        symbols = ("zd_start", "zd_run", "zd_pack", "zd_selftest", "zd_state_size")
        self.start, self.run, self.pack, self.selftest, size = (lib[name] for name in symbols)
        for function in (self.pack, self.selftest, size):
            function.restype = ctypes.c_uint32
        self.save, self.restore = (lib[f"{job['prefix']}_{name}"] for name in ("save", "restore"))
        self.restore.restype = ctypes.c_uint32
        self.state = Buffer(int(size()))
        self.copy = Buffer(self.state.size + int(str(job["saved_extra"])))
        self.packed = Buffer(8 * (self.state.size + 64))
        self.sum = 0

    def add(self, answer: bytes) -> None:
        """Add to the checksum."""
        self.sum = zlib.crc32(answer, self.sum)

    def step(self, codes: bytes, steps: int) -> None:
        """Run so many steps from the present state; add drifts and flags."""
        drift, flags = Buffer(4 * steps * self.outputs), Buffer(4 * steps)
        nodes = Buffer(4 * steps * self.values)
        trace = nodes.bytes if self.values else None
        self.run(self.state.bytes, codes, ctypes.c_uint32(steps), drift.bytes, flags.bytes, trace)
        self.add(drift.take() + flags.take())
        self.check(drift, flags, nodes)

    def check(self, *buffers: Buffer) -> None:
        """End the process if something was written beyond its end."""
        for name, buffer in (("its state", self.state), ("its copy", self.copy)):
            if not buffer.is_intact():
                raise SystemExit(f"it writes beyond {name}")
        if not all(buffer.is_intact() for buffer in buffers):
            raise SystemExit("it writes beyond drifts, flags or nodes")

    def tell(self, name: str) -> None:
        """Print the checksum of what was answered since it was last told."""
        print(f"= {name} {self.sum:08x}", flush=True)
        self.sum = 0

    def add_state(self) -> None:
        """Add the state, as numbers in the order of the reference."""
        count = int(self.pack(self.state.bytes, self.packed.bytes))
        self.add(self.packed.bytes.raw[: 8 * count])


def main() -> None:
    """Do what the job's file says."""
    path = Path(sys.argv[1])
    job = json.loads(path.read_text(encoding="utf-8"))
    lib = Library(job)
    codes = path.with_suffix(".codes").read_bytes()
    at = 0
    pieces = []
    for name, steps, settled in job["stretches"]:
        piece = codes[at : at + steps * job["row_bytes"]]
        at += len(piece)
        pieces.append(piece)
        print(name, flush=True)
        lib.start(lib.state.bytes, piece, ctypes.c_int(settled))
        lib.step(piece, steps)
        lib.add_state()
        lib.tell(name)
    print("the self-test", flush=True)
    lib.add(str(lib.selftest()).encode())
    lib.tell("the self-test")
    if job["damages"]:
        two = pieces[0][: 2 * job["row_bytes"]]
        for settled in (1, 0):
            lib.start(lib.state.bytes, pieces[0], ctypes.c_int(settled))
            lib.step(pieces[0], min(STEPS, job["stretches"][0][1]))
            sound = lib.state.take()
            for name, damaged in list_damaged(sound, settled):
                print(name, flush=True)
                try_state(lib, damaged, sound, two)
            lib.tell("damaged and random states")


def try_state(lib: Library, damaged: bytes, sound: bytes, codes: bytes) -> None:
    """Step and go on from a damaged state; restore a copy of it over a sound one."""
    lib.state.put(damaged)
    lib.save(lib.state.bytes, lib.copy.bytes)
    lib.step(codes, 2)
    lib.add_state()
    lib.state.put(sound)
    lib.add(str(lib.restore(lib.state.bytes, lib.copy.bytes)).encode())
    lib.step(codes, 1)
    lib.add_state()


def list_damaged(sound: bytes, seed: int) -> list[tuple[str, bytes]]:
    """Return states, each with what is said of it: a byte or a word changed, or all of them."""
    found = []
    size = len(sound)
    for at in range(0, size, -(-size // MOST_PLACES)):
        for byte in (sound[at] ^ 0x80, 0x7F, sound[at] ^ 1):
            whole = sound[:at] + bytes([byte]) + sound[at + 1 :]
            found.append((f"a state whose byte {at} is 0x{byte:02x}", whole))
    words = size // 4
    for k in range(0, words, -(-words // MOST_PLACES)):
        for word in WORDS:
            whole = sound[: 4 * k] + word.to_bytes(4, sys.byteorder) + sound[4 * k + 4 :]
            found.append((f"a state whose bytes from {4 * k} are 0x{word:08x}", whole))
    rng = random.Random(seed)
    for number in range(RANDOM_STATES):
        noise = rng.randbytes(size)
        part = rng.randrange(size + 1) if number % 2 else 0
        found.append((f"random state {number}", sound[:part] + noise[part:]))
    return found


if __name__ == "__main__":
    main()
